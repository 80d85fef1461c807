"""Environments draw from generators of their own: global ones stay, and no two start alike."""

import random

import gymnasium
import numpy as np
import pytest
import torch

import navrl  # noqa: F401  registers the environment
from navrl import factory
from navrl.config import compose, instantiate

SMALL = ["scenario=corridor", "pool_size=4", "num_threads=1"]


def make(seed, num_worlds=2):
    cfg = compose("train", SMALL)
    return factory.make_navigation_env(cfg, num_worlds, factory.make_pool(cfg), seed)


def global_states():
    numpy_state = np.random.get_state()  # noqa: NPY002 -- the global one is what is tested
    return torch.get_rng_state(), random.getstate(), numpy_state[1].tolist(), numpy_state[2:]


def assert_unchanged(before):
    after = global_states()
    assert torch.equal(before[0], after[0])
    assert before[1:] == after[1:]


@pytest.mark.parametrize("seed", [None, 3])
def test_environment_keeps_global_random_state(seed):
    before = global_states()
    env = make(seed)
    td = env.reset()
    td["action"] = torch.zeros(2, 2)
    td = env.step(td)["next"]
    env.reset(td.set("_reset", torch.tensor([[True], [False]])))
    env.set_seed(seed)
    env.reset()
    assert_unchanged(before)


def test_transformed_environment_keeps_global_random_state():
    cfg = compose("train", SMALL)
    before = global_states()
    env = factory.make_env(make(None), instantiate(cfg.transforms))
    env.set_seed(1)
    env.reset()
    assert_unchanged(before)


def test_gymnasium_environment_keeps_global_random_state():
    before = global_states()
    env = gymnasium.make("navrl/Navigation-v0", overrides=SMALL)
    env.reset(seed=4)
    env.step(np.zeros(2, dtype=np.float32))
    env.reset()
    assert_unchanged(before)


@pytest.mark.parametrize("name", ["random", "pure_pursuit", "dwa"])
def test_controllers_keep_global_random_state(name):
    cfg = compose("train", [*SMALL, f"+controller@policy={name}"])
    env = factory.make_env(make(None), instantiate(cfg.transforms))
    before = global_states()
    policy = instantiate(cfg.policy, robot=env.base_env.simulator.robot)
    policy(env.reset())
    assert_unchanged(before)


def test_environments_without_a_seed_differ():
    torch.manual_seed(0)
    first = make(None).reset()["ranges"]
    torch.manual_seed(0)
    assert not torch.equal(first, make(None).reset()["ranges"])


def test_seed_none_draws_fresh_entropy():
    env = make(5)
    env.set_seed(None)
    first = env.reset()["ranges"]
    env.set_seed(None)
    assert not torch.equal(first, env.reset()["ranges"])
