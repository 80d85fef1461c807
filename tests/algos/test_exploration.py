"""Correlated noise is stationary, restarts with episodes and continues from its key."""

import math

import pytest
import torch
from tensordict import TensorDict

from navrl.algos import CorrelatedExploration, GaussianExploration
from navrl.keys import EXPLORATION_NOISE

FIXED = {"sigma_initial": 0.1, "sigma_final": 0.1}


def noise(explore, carrier, steps):
    """Return the noise ``[T, N, C]`` of T steps of a policy that outputs zero."""
    found = []
    for _ in range(steps):
        carrier["action"] = torch.zeros(len(carrier), 2)
        found.append(explore(carrier, 0)["action"].clone())
    return torch.stack(found)


def test_noise_is_stationary_with_the_set_correlation():
    torch.manual_seed(0)
    explore = CorrelatedExploration(correlation_time_s=0.4, time_step_s=0.2, **FIXED)
    found = noise(explore, TensorDict({}, 20_000), 4)
    assert found.std(dim=(1, 2)).tolist() == pytest.approx([0.1] * 4, abs=0.002)
    correlation = [(found[0] * found[k]).mean() / 0.01 for k in (1, 2)]
    assert correlation == pytest.approx([math.exp(-0.5), math.exp(-1.0)], abs=0.02)


def test_zero_correlation_time_is_white_noise():
    torch.manual_seed(0)
    white = noise(GaussianExploration(**FIXED), TensorDict({}, 8), 3)
    torch.manual_seed(0)
    explore = CorrelatedExploration(correlation_time_s=0.0, **FIXED)
    assert torch.equal(noise(explore, TensorDict({}, 8), 3), white)


def test_new_episode_starts_with_new_noise():
    torch.manual_seed(0)
    explore = CorrelatedExploration(correlation_time_s=1e9, **FIXED)  # does not change
    carrier = TensorDict({}, 4)
    before = noise(explore, carrier, 1)[0]
    carrier[EXPLORATION_NOISE][:2] = torch.nan
    after = noise(explore, carrier, 1)[0]
    torch.testing.assert_close(after[2:], before[2:], atol=1e-4, rtol=0.0)
    assert ((after[:2] - before[:2]).abs() > 1e-3).all()


@pytest.mark.parametrize("option", [{"correlation_time_s": -0.1}, {"time_step_s": 0.0}])
def test_bad_times_are_named(option):
    with pytest.raises(ValueError, match=next(iter(option))):
        CorrelatedExploration(**option)
