"""Intervals against the textbook's formula."""

import math

import pytest
from scipy.stats import norm

from navrl.evaluation import wilson_interval


@pytest.mark.parametrize("successes, total", [(0, 10), (10, 10), (81, 100), (3, 7)])
@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_is_the_score_interval(successes, total, confidence):
    z, rate = norm.ppf((1 + confidence) / 2), successes / total
    centre = (rate + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z * math.sqrt(rate * (1 - rate) / total + z**2 / (4 * total**2)) / (1 + z**2 / total)
    expected = max(centre - half, 0.0), min(centre + half, 1.0)
    assert wilson_interval(successes, total, confidence) == pytest.approx(expected, abs=1e-12)


def test_without_trials_nothing_is_known():
    assert all(math.isnan(bound) for bound in wilson_interval(0, 0))
