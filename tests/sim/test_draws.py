"""Distributions of values that episodes draw from their seed."""

import math

import pytest
import torch

from navrl.sim import LogUniform, Uniform
from navrl.sim.draws import draw, draw_row, limits, nominal

SEEDS = torch.arange(4000)


def test_log_uniform_draws_are_uniform_in_the_logarithm():
    value = draw("a", LogUniform(0.3, 3.0), SEEDS)
    assert 0.3 <= value.min() < 0.301 and 2.99 < value.max() <= 3.0
    share = (value / 0.3).log() / math.log(10.0)
    assert share.mean().item() == pytest.approx(0.5, abs=0.02)
    assert share.std().item() == pytest.approx(12**-0.5, abs=0.01)


@pytest.mark.parametrize("low, high", [(0.3, 3.0), (2.0, 2.0), (1e-3, 10.0)])
def test_log_uniform_quantiles_are_powers(low, high):
    share = torch.linspace(0.0, 1.0, 11, dtype=torch.float64)
    expected = low * (high / low) ** share
    torch.testing.assert_close(LogUniform(low, high).quantile(share), expected, rtol=1e-9, atol=0)


def test_draw_is_bit_equal_at_any_position_in_a_batch():
    value = LogUniform(0.3, 3.0)
    together = draw("a", value, SEEDS)
    for start in (0, 1, 3, 1001):
        assert draw("a", value, SEEDS[start:]).equal(together[start:])
    assert draw("a", value, SEEDS[7:8]).item() == together[7].item()


def test_row_has_the_draws_of_its_names():
    values = [("a", Uniform(-1.0, 2.0)), ("b", math.inf), ("c", LogUniform(1.0, 5.0))]
    expected = torch.stack([draw(name, value, SEEDS) for name, value in values], dim=-1)
    assert draw_row(values, SEEDS).equal(expected)


@pytest.mark.parametrize(
    "value, middle, ends",
    [
        (0.4, 0.4, (0.4, 0.4)),
        (Uniform(1.0, 3.0), 2.0, (1.0, 3.0)),
        (LogUniform(0.5, 8.0), 2.0, (0.5, 8.0)),
    ],
)
def test_nominal_value_is_the_median(value, middle, ends):
    assert nominal(value) == pytest.approx(middle, rel=1e-9)
    assert limits(value) == ends


@pytest.mark.parametrize("low, high", [(0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (1.0, math.inf)])
def test_invalid_log_uniform_is_rejected(low, high):
    with pytest.raises(ValueError, match=f"low={low}"):
        LogUniform(low, high)
