"""Estimates and tests against textbook formulas and against what they promise."""

import math

import numpy as np
import pytest
from scipy.stats import binom, norm, ttest_rel

from navrl.evaluation.statistics import (
    bootstrap_mean,
    holm,
    interquartile_mean,
    mcnemar_p_value,
    paired_difference,
    stratified_bootstrap,
    wilson_interval,
)


@pytest.mark.parametrize("successes, total", [(0, 10), (10, 10), (81, 100), (3, 7)])
@pytest.mark.parametrize("confidence", [0.9, 0.95])
def test_wilson_interval_equals_the_score_interval(successes, total, confidence):
    z, rate = norm.ppf((1 + confidence) / 2), successes / total
    center = (rate + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z * math.sqrt(rate * (1 - rate) / total + z**2 / (4 * total**2)) / (1 + z**2 / total)
    expected = max(center - half, 0.0), min(center + half, 1.0)
    assert wilson_interval(successes, total, confidence) == pytest.approx(expected, abs=1e-12)


def test_interval_without_trials_is_undefined():
    assert all(math.isnan(bound) for bound in wilson_interval(0, 0))


def test_bootstrap_agrees_with_the_normal_interval():
    times = np.random.default_rng(3).normal(9.0, 2.0, size=400)
    found = bootstrap_mean(times)
    half = 1.96 * times.std(ddof=1) / math.sqrt(400)
    assert found.value == pytest.approx(times.mean())
    assert (found.low, found.high) == pytest.approx(
        (times.mean() - half, times.mean() + half), abs=half / 8
    )
    assert found.n == 400
    wider = bootstrap_mean(times, confidence=0.99)
    assert wider.low < found.low and found.high < wider.high
    assert bootstrap_mean(times) == found  # the same table twice


def test_bootstrap_of_few_values():
    assert bootstrap_mean([]).n == 0 and math.isnan(bootstrap_mean([]).value)
    with pytest.raises(ValueError, match="inf"):
        bootstrap_mean([1.0, math.inf])


def test_mcnemar_is_the_binomial_test_of_discordant_pairs():
    # 5 won by both, 8 by the first alone, 2 by the second alone, 4 by neither
    first = [True] * 13 + [False] * 6
    second = [True] * 5 + [False] * 8 + [True] * 2 + [False] * 4
    expected = 2 * binom.cdf(2, 10, 0.5)
    assert mcnemar_p_value(first, second) == pytest.approx(expected)
    assert mcnemar_p_value(second, first) == pytest.approx(expected)
    assert mcnemar_p_value(first, first) == 1.0
    with pytest.raises(ValueError, match="same episodes"):
        mcnemar_p_value(first, second[:-1])


def test_pairing_detects_differences_despite_episode_spread():
    rng = np.random.default_rng(0)
    length = rng.uniform(4, 20, size=200)  # some episodes are long for everybody
    first, second = length + rng.normal(0.1, 0.3, 200), length
    found = paired_difference(first, second)
    reference = ttest_rel(first, second)
    assert found.value == pytest.approx((first - second).mean())
    assert found.low < found.value < found.high
    interval = reference.confidence_interval()
    assert (found.low, found.high) == pytest.approx(tuple(interval), abs=0.01)
    assert found.p_value < 0.01 and found.n == 200
    shuffled = paired_difference(first, rng.permutation(second))
    assert shuffled.p_value > 0.05  # unpaired, nothing can be told


def test_p_values_are_uniform_without_a_difference():
    rng = np.random.default_rng(1)
    draws = rng.normal(size=(300, 40))
    p_values = [paired_difference(row, np.zeros(40), resamples=400).p_value for row in draws]
    assert 0.02 < np.mean(np.array(p_values) < 0.05) < 0.10
    assert 0.4 < np.mean(p_values) < 0.6


def test_holm_ignores_missing_tests():
    corrected = holm([0.01, math.nan, 0.04])
    assert corrected[::2] == pytest.approx([0.02, 0.04]) and math.isnan(corrected[1])
    assert math.isnan(holm([math.nan])[0])


@pytest.mark.parametrize(
    "function, arguments, message",
    [
        (holm, ([0.5, 1.5],), r"^p_values=1.5: must be in \[0, 1\]"),
        (holm, ([-0.1],), r"^p_values=-0.1: must be"),
        (mcnemar_p_value, ([True, math.nan] * 4, [True] * 8), "^first=nan: must be finite"),
        (mcnemar_p_value, ([True] * 8, [math.nan] * 8), "^second=nan: must be finite"),
        (interquartile_mean, ([0.5, math.nan],), "^scores=nan: must be finite"),
        (interquartile_mean, ([],), r"^scores=\[\]: must have"),
        (wilson_interval, (5, 4), "^successes=5: must be in 0 to 4"),
        (wilson_interval, (1, 0), "^successes=1: must be in 0 to 0"),
        (wilson_interval, (math.nan, 4), "^successes=nan: must be in 0 to 4"),
    ],
)
def test_values_outside_their_range_are_named(function, arguments, message):
    with pytest.raises(ValueError, match=message):
        function(*arguments)


def test_interquartile_mean_excludes_outer_quarters():
    assert interquartile_mean(np.array([0.0, 1.0, 2.0, 100.0])) == pytest.approx(1.5)
    assert interquartile_mean(np.arange(8.0).reshape(2, 4)) == pytest.approx(3.5)


def test_seeds_are_drawn_within_each_task():
    # Tasks differ much, seeds do not: strata keep the interval narrow.
    scores = np.array([[0.1, 0.5, 0.9], [0.12, 0.52, 0.92], [0.11, 0.51, 0.91]])
    found = stratified_bootstrap(scores)
    assert found.n == 3
    assert found.value == pytest.approx(interquartile_mean(scores))
    assert found.low >= 0.5 and found.high <= 0.52
    spread = stratified_bootstrap(np.array([[0.2], [0.5], [0.8], [0.9]]))
    assert spread.high - spread.low > 0.2
    opposite = stratified_bootstrap(np.array([[0.0, 1.0], [1.0, 0.0], [0.5, 0.5]]))
    assert opposite.high - opposite.low > 0.3  # drawn together they would always cancel
    lucky = stratified_bootstrap(np.array([[0.5 + 0.001 * k] for k in range(11)] + [[0.0]]))
    assert lucky.value > 0.5 and lucky.low >= 0.5  # a mean would follow the one that failed
    with pytest.raises(ValueError, match="scores"):
        stratified_bootstrap(np.array([0.4, 0.6]))
