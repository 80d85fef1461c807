"""SuperSuit's wrappers, those of PettingZoo, apply to the registered environment."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation
from pages import files

supersuit = pytest.importorskip("supersuit")

import navrl  # noqa: E402, F401  registers the environment

OVERRIDES = ["scenario=corridor", "pool_size=4", "num_threads=1", "lidar.num_beams=36"]


def flat():
    return FlattenObservation(gymnasium.make("navrl/Navigation-v0", overrides=OVERRIDES))


def test_frames_are_stacked():
    env, own = supersuit.frame_stack_v1(flat(), 3), flat()
    stacked, _ = env.reset(seed=0)
    frames = [own.reset(seed=0)[0]]
    for _ in range(2):
        stacked, *_ = env.step(np.array([0.5, 0.0], np.float32))
        frames.append(own.step(np.array([0.5, 0.0], np.float32))[0])
    np.testing.assert_array_equal(stacked, np.concatenate(frames))


def test_actions_and_rewards_are_changed():
    env = supersuit.reward_lambda_v0(supersuit.clip_actions_v0(flat()), lambda reward: 2.0 * reward)
    own = flat()
    env.reset(seed=0), own.reset(seed=0)
    _, doubled, *_ = env.step(np.array([9.0, 0.0], np.float32))
    _, reward, *_ = own.step(np.array([1.0, 0.0], np.float32))
    assert doubled == pytest.approx(2.0 * reward) and reward != 0.0


def test_script_of_the_page_runs(capsys):
    page = Path(__file__).parents[2] / "docs" / "gymnasium.md"
    exec(compile(files(page)["stack_frames.py"], page.name, "exec"), {"__name__": "snippet"})
    assert capsys.readouterr().out
