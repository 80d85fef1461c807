"""Measure steps per CPU second of the vector environment beside gymnasium's SyncVectorEnv."""

import time
from functools import partial

import gymnasium
import torch
from gymnasium.vector import SyncVectorEnv

import navrl  # noqa: F401  registers the environment

ID, OVERRIDES = "navrl/Navigation-v0", ["scenario=paper", "pool_size=64", "num_threads=1"]


def steps_per_cpu_second(envs, num_steps):
    """Return environment steps per CPU second, with random actions."""
    envs.reset(seed=0)
    for _ in range(3):
        envs.step(envs.action_space.sample())
    start = time.process_time()
    for _ in range(num_steps):
        envs.step(envs.action_space.sample())
    return num_steps * envs.num_envs / (time.process_time() - start)


def main():
    torch.set_num_threads(1)
    for observation in ("raw", "transformed"):
        options = {"overrides": OVERRIDES, "observation": observation}
        single = SyncVectorEnv([partial(gymnasium.make, ID, **options)] * 8)
        base = steps_per_cpu_second(single, 30)
        print(f"{observation}: SyncVectorEnv with 8 environments: {base:,.0f} steps per CPU second")
        for num_envs in (8, 64, 256, 1024):
            found = steps_per_cpu_second(gymnasium.make_vec(ID, num_envs, **options), 20)
            print(f"{observation}: {num_envs} worlds: {found:,.0f}, {found / base:.1f} times")


if __name__ == "__main__":
    main()
