"""TorchRL's gymnasium wrappers on the registered environment."""

import gymnasium
import pytest
import torch
from gymnasium.vector import AutoresetMode
from torchrl.envs import GymEnv, GymWrapper
from torchrl.envs.utils import check_env_specs

import navrl  # noqa: F401  registers the environment
from navrl.envs import Outcome

SHORT = [
    *("scenario=corridor", "pool_size=4", "num_threads=1", "empty_share=0"),
    "environment.time_limit_steps=3",
]


def test_gym_env_by_name():
    env = GymEnv("navrl/Navigation-v0", overrides=SHORT)
    check_env_specs(env, seed=0)
    rollout = env.rollout(10, break_when_any_done=False)
    assert rollout["ranges"].shape == (10, 1440)
    assert rollout["next", "done"].squeeze(-1).tolist() == [False, False, True] * 3 + [False]


def test_gym_env_renders_pixels():
    env = GymEnv("navrl/Navigation-v0", overrides=SHORT, from_pixels=True, pixels_only=False)
    pixels = env.rollout(2)["pixels"]
    assert pixels.shape == (2, 480, 480, 3) and pixels.dtype == torch.uint8


def test_gym_wrapper_reads_the_info():
    base = gymnasium.make("navrl/Navigation-v0", overrides=SHORT)
    env = GymWrapper(base).auto_register_info_dict()
    check_env_specs(env, seed=0)
    batch = env.rollout(3)["next"]
    assert batch["outcome"].flatten().tolist() == [0, 0, Outcome.TIMEOUT]
    assert batch["is_success"].dtype == torch.bool
    terms = [value for key, value in batch.items() if key.startswith("reward_")]
    torch.testing.assert_close(sum(terms).flatten(), batch["reward"].flatten())


def test_gym_wrapper_of_a_vector_environment():
    vector = gymnasium.make_vec(
        "navrl/Navigation-v0",
        num_envs=2,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
        overrides=SHORT,
    )
    env = GymWrapper(vector)  # TorchRL reads the infos of vector environments as they are
    batch = env.rollout(7, break_when_any_done=False)
    assert batch["next", "done"].squeeze(-1).sum().item() == 4
    assert batch["next", "outcome"].tolist() == [[0, 0, Outcome.TIMEOUT] * 2 + [0]] * 2
    assert not batch["next", "is_success"].any()


@pytest.mark.slow
def test_gym_env_as_processes_without_a_seed_differ():
    env = GymEnv("navrl:navrl/Navigation-v0", num_envs=2, overrides=SHORT)
    first, second = env.reset()["ranges"]
    assert not torch.equal(first, second)
    env.close()
