"""Estimates with their uncertainty: of one run, of two on the same episodes, of several seeds.

Everything random here is drawn from a fixed seed, so that a table made twice is the same table.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest, bootstrap, trim_mean

_SEED = 2024
_RESAMPLES = 2000  # an interval's end is then known to about 2 % of its width


class Estimate(NamedTuple):
    """A number, how sure it is, and from how many."""

    value: float
    """The estimate; NaN from no sample."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""
    n: int
    """Samples."""


class PairedDifference(NamedTuple):
    """How much one run differs from another on the same episodes."""

    value: float
    """Mean difference; NaN from no pair."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""
    p_value: float
    """Two-sided, of no difference."""
    n: int
    """Pairs."""


def wilson_interval(successes: int, total: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Wilson score interval of a rate.

    Args:
        successes: Of ``total``.
        total: Number of trials.
        confidence: Level in (0, 1).

    Returns:
        (low, high) rates; (nan, nan) without trials.

    Reference:
        Wilson, "Probable inference, the law of succession, and statistical inference", 1927.
    """
    if total == 0:
        return math.nan, math.nan
    interval = binomtest(successes, total).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def bootstrap_mean(
    values: Sequence[float], confidence: float = 0.95, resamples: int = _RESAMPLES
) -> Estimate:
    """Return the mean of values that are not normal, such as times, with its interval.

    Args:
        values: Finite, one an episode.
        confidence: Level in (0, 1).
        resamples: Of the bootstrap.

    Returns:
        Mean and percentile bootstrap interval; of a single value, that value without width.

    Raises:
        ValueError: If a value is not finite.

    Reference:
        Efron, "Bootstrap methods: another look at the jackknife", 1979.
    """
    sample = _finite("values", values)
    if len(sample) == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    mean = float(sample.mean())
    if np.ptp(sample) == 0:
        return Estimate(mean, mean, mean, len(sample))
    low, high, _ = _bootstrap(sample, confidence, resamples)
    return Estimate(mean, low, high, len(sample))


def mcnemar_p_value(first: Sequence[bool], second: Sequence[bool]) -> float:
    """Return the exact two-sided p-value that two runs win the same share of the same episodes.

    Args:
        first: Which episodes the first won.
        second: Which of the same episodes the second won.

    Returns:
        1 if they won the same ones.

    Raises:
        ValueError: If the numbers of episodes differ.

    Reference:
        McNemar, "Note on the sampling error of the difference between correlated proportions",
        1947, with the binomial distribution in place of the chi-squared approximation.
    """
    _check_pairs(first, second)
    only_first = sum(bool(a) and not b for a, b in zip(first, second, strict=True))
    only_one = sum(bool(a) != bool(b) for a, b in zip(first, second, strict=True))
    return float(binomtest(only_first, only_one).pvalue) if only_one else 1.0


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number: at 0.05, one in twenty tables errs, not tests.

    Args:
        p_values: Of one family of tests, in any order.

    Returns:
        In the same order, at most 1.

    Reference:
        Holm, "A simple sequentially rejective multiple test procedure", 1979.
    """
    corrected, floor = [0.0] * len(p_values), 0.0
    for rank, place in enumerate(sorted(range(len(p_values)), key=lambda k: p_values[k])):
        floor = max(floor, min(1.0, (len(p_values) - rank) * p_values[place]))
        corrected[place] = floor
    return corrected


def paired_difference(
    first: Sequence[float],
    second: Sequence[float],
    confidence: float = 0.95,
    resamples: int = _RESAMPLES,
) -> PairedDifference:
    """Return the mean of first - second over the same episodes, by a paired bootstrap.

    Pairing takes out that some episodes are long for everybody.

    Args:
        first: Finite, one an episode.
        second: Likewise, of the same episodes in the same order.
        confidence: Level in (0, 1).
        resamples: Of the bootstrap, which draws episodes. The smallest p-value that can be told is
            1 / (resamples + 1).

    Returns:
        Difference, percentile interval, and the p-value: how often the differences, shifted to mean
        zero, have a mean at least as far from it.

    Raises:
        ValueError: If the numbers of episodes differ, or a value is not finite.

    Reference:
        Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, Sec. 16.4.
    """
    _check_pairs(first, second)
    differences = _finite("first", first) - _finite("second", second)
    if len(differences) == 0:
        return PairedDifference(math.nan, math.nan, math.nan, math.nan, 0)
    mean = float(differences.mean())
    if np.ptp(differences) == 0:
        signs = len(differences) if mean else 0  # all alike: the sign test, as nothing can be drawn
        return PairedDifference(mean, mean, mean, min(1.0, 2 * 0.5**signs), len(differences))
    low, high, means = _bootstrap(differences, confidence, resamples)
    extreme = int((np.abs(means - mean) >= abs(mean)).sum())
    p_value = (extreme + 1) / (resamples + 1)
    return PairedDifference(mean, low, high, p_value, len(differences))


def interquartile_mean(scores: np.ndarray) -> float:
    """Return the mean of the middle half of all ``scores``, of any shape.

    It ignores a lucky and a failed run as the median does, and wastes less of the rest.

    Reference:
        Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice",
        2021, Sec. 4.3.
    """
    return float(trim_mean(np.asarray(scores, dtype=float), 0.25, axis=None))


def stratified_bootstrap(
    scores: np.ndarray, confidence: float = 0.95, resamples: int = _RESAMPLES
) -> Estimate:
    """Return the interquartile mean over training seeds and tasks, with its interval.

    Args:
        scores: ``[R, M]``, of R training runs (seeds) on M tasks, such as kinds of worlds.
        confidence: Level in (0, 1).
        resamples: Of the bootstrap, which draws runs with replacement, for each task apart.

    Returns:
        Interquartile mean of all R x M scores, percentile interval, and R. Of a single run the
        interval is NaN: nothing is known of the spread.

    Raises:
        ValueError: If ``scores`` is not ``[R, M]`` with at least one score, all finite.

    Reference:
        Agarwal et al. 2021, Sec. 4.1 and 4.3; as in their library, rliable.
    """
    scores = np.asarray(scores, dtype=float)
    if scores.ndim != 2 or scores.size == 0 or not np.isfinite(scores).all():
        raise ValueError(f"scores: need [runs, tasks] of finite numbers, got {list(scores.shape)}")
    value, (runs, tasks) = interquartile_mean(scores), scores.shape
    if runs == 1:
        return Estimate(value, math.nan, math.nan, 1)
    rows = np.random.default_rng(_SEED).integers(runs, size=(resamples, runs, tasks))
    drawn = np.take_along_axis(scores[None], rows, axis=1).reshape(resamples, -1)
    means = trim_mean(drawn, 0.25, axis=1)
    tail = 50 * (1 - confidence)
    low, high = np.percentile(means, [tail, 100 - tail])
    return Estimate(value, float(low), float(high), runs)


def _bootstrap(
    sample: np.ndarray, confidence: float, resamples: int
) -> tuple[float, float, np.ndarray]:
    """Return the percentile interval of the mean, and the means of all resamples."""
    result = bootstrap(
        (sample,),
        np.mean,
        n_resamples=resamples,
        confidence_level=confidence,
        method="percentile",
        vectorized=True,
        batch=200,
        rng=np.random.default_rng(_SEED),
    )
    interval = result.confidence_interval
    return float(interval.low), float(interval.high), result.bootstrap_distribution


def _finite(name: str, values: Sequence[float]) -> np.ndarray:
    array = np.asarray(values, dtype=float)
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: need finite numbers, got {array[~np.isfinite(array)][0]}")
    return array


def _check_pairs(first: Sequence, second: Sequence) -> None:
    if len(first) != len(second):
        raise ValueError(f"need the same episodes, got {len(first)} and {len(second)}")


def p_value_text(value: float) -> str:
    """Return ``< 0.001`` or three decimals."""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"
