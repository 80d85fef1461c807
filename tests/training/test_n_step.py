"""Transitions over several steps, against a loop written out by hand."""

import pytest
import torch
from tensordict import TensorDict

from navrl.training.n_step import STEPS, NStepReturn

GAMMA, WORLDS, LENGTH = 0.9, 7, 40


@pytest.fixture
def steps():
    generator = torch.Generator().manual_seed(1)
    result = []
    for t in range(LENGTH):
        done = torch.rand(WORLDS, 1, generator=generator) < 0.25
        terminated = done & (torch.rand(WORLDS, 1, generator=generator) < 0.5)
        following = {
            "x": torch.full((WORLDS, 1), t + 0.5),
            "reward": torch.randn(WORLDS, 1, generator=generator),
            "done": done,
            "terminated": terminated,
        }
        step = {"x": torch.full((WORLDS, 1), float(t)), "next": TensorDict(following, [WORLDS])}
        result.append(TensorDict(step, [WORLDS]))
    return result


@pytest.mark.parametrize("num_steps", [2, 3, 5])
def test_n_step_return_equals_the_explicit_sum(steps, num_steps):
    fold = NStepReturn(num_steps, GAMMA)
    complete = [out for out in map(fold, steps) if out is not None]
    assert len(complete) == LENGTH - num_steps + 1
    for start, out in enumerate(complete):
        for world in range(WORLDS):
            total, last = 0.0, start
            for k in range(num_steps):
                last = start + k
                total += GAMMA**k * float(steps[last]["next", "reward"][world])
                if steps[last]["next", "done"][world]:
                    break
            assert float(out["x"][world]) == start
            assert float(out["next", "x"][world]) == last + 0.5
            assert float(out["next", "reward"][world]) == pytest.approx(total, abs=1e-5)
            assert int(out[STEPS][world]) == last - start + 1
            for flag in ("done", "terminated"):
                assert out["next", flag][world] == steps[last]["next", flag][world]


def test_one_step_returns_are_unchanged(steps):
    assert NStepReturn(1, GAMMA)(steps[0]) is steps[0]


def test_pending_steps_are_restored(steps):
    fold, resumed = NStepReturn(3, GAMMA), NStepReturn(3, GAMMA)
    for step in steps[:5]:
        fold(step)
    resumed.load_state_dict(fold.state_dict())
    assert (fold(steps[5]) == resumed(steps[5])).all()


def test_invalid_arguments_are_rejected(steps):
    with pytest.raises(ValueError, match="num_steps=0"):
        NStepReturn(0)
    fold = NStepReturn(2)
    fold(steps[0])
    with pytest.raises(ValueError, match="same 7 worlds"):
        fold(steps[0][:3])
