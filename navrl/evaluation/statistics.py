"""Estimates with uncertainty for single runs, paired runs and training seeds.

Resampling uses a fixed seed, so that tables are reproducible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest, bootstrap, trim_mean

from navrl.evaluation.sign_flips import center_interval, sign_flip_p_value

MIN_PAIRS = 6
"""Minimum number of values for an interval and of pairs for a test; 5 cannot give p < 0.05."""

MIN_SEEDS = 3
"""Minimum number of training seeds for an interval."""

_SEED = 2024
_RESAMPLES = 2000  # determines an interval's ends to about 2 % of its width
_MAX_SMALL_SAMPLE = (
    50  # values up to which a percentile bootstrap is too narrow: 7 % of intervals miss at 20
)
_UNKNOWN = (math.nan, math.nan)


class Estimate(NamedTuple):
    """Estimate with confidence interval and sample size."""

    value: float
    """The estimate; NaN without samples."""
    low: float
    """Lower end of the interval; NaN without one."""
    high: float
    """Upper end of the interval; NaN without one."""
    n: int
    """Number of samples."""


class PairedDifference(NamedTuple):
    """Difference of two runs on the same episodes."""

    value: float
    """Mean difference; NaN without pairs."""
    low: float
    """Lower end of the interval; NaN without one."""
    high: float
    """Upper end of the interval; NaN without one."""
    p_value: float
    """Two-sided p-value of no difference; NaN for fewer than :data:`MIN_PAIRS` pairs."""
    n: int
    """Number of pairs."""


def wilson_interval(successes: int, total: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the Wilson score interval of a rate.

    Args:
        successes: Number of successes among ``total``.
        total: Number of trials.
        confidence: Level in (0, 1).

    Returns:
        (low, high) rates; (nan, nan) without trials.

    Raises:
        ValueError: If ``successes`` is not in 0 to ``total``.

    Reference:
        Wilson, "Probable inference, the law of succession, and statistical inference", 1927.
    """
    if not 0 <= successes <= total:
        raise ValueError(f"successes={successes}: must be in 0 to {total}")
    if total == 0:
        return _UNKNOWN
    interval = binomtest(successes, total).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def bootstrap_mean(
    values: Sequence[float] | np.ndarray, confidence: float = 0.95, resamples: int = _RESAMPLES
) -> Estimate:
    """Return the mean of non-normal values, such as times, with a bootstrap interval.

    Args:
        values: Finite values, one per episode.
        confidence: Level in (0, 1).
        resamples: Number of bootstrap resamples.

    Returns:
        Mean and percentile bootstrap interval; for 50 values or fewer the interval of
        :func:`navrl.evaluation.sign_flips.center_interval`; none for fewer than :data:`MIN_PAIRS`
        values, or if all values are equal.

    Raises:
        ValueError: If a value is not finite.

    Reference:
        Efron, "Bootstrap methods: another look at the jackknife", 1979.
    """
    sample = _finite("values", values)
    if len(sample) == 0:
        return Estimate(math.nan, *_UNKNOWN, 0)
    interval = _mean_interval(sample, confidence, resamples)
    return Estimate(float(sample.mean()), *interval, len(sample))


def mcnemar_p_value(first: Sequence[bool], second: Sequence[bool]) -> float:
    """Return the exact two-sided p-value of equal success of two runs on the same episodes.

    Args:
        first: Success of the first run per episode.
        second: Success of the second run on the same episodes.

    Returns:
        1 if they succeed in the same ones; NaN for fewer than :data:`MIN_PAIRS` episodes.

    Raises:
        ValueError: If the numbers of episodes differ, or a value is not finite.

    Reference:
        McNemar, "Note on the sampling error of the difference between correlated proportions",
        1947, with the binomial distribution in place of the chi-squared approximation.
    """
    _check_pairs(first, second)
    _finite("first", first), _finite("second", second)  # bool(NaN) is a success
    if len(first) < MIN_PAIRS:
        return math.nan
    only_first = sum(bool(a) and not b for a, b in zip(first, second, strict=True))
    only_one = sum(bool(a) != bool(b) for a, b in zip(first, second, strict=True))
    return float(binomtest(only_first, only_one).pvalue) if only_one else 1.0


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values with Holm's correction for multiple tests.

    Args:
        p_values: p-values of one family of tests, in any order; NaN for one without a test, which
            does not count in the number of tests.

    Returns:
        Corrected p-values in the same order, at most 1; NaN without a test.

    Raises:
        ValueError: If a p-value is outside [0, 1].

    Reference:
        Holm, "A simple sequentially rejective multiple test procedure", 1979.
    """
    corrected, floor = [math.nan] * len(p_values), 0.0
    tested = [place for place, value in enumerate(p_values) if not math.isnan(value)]
    for place in tested:
        if not 0.0 <= p_values[place] <= 1.0:
            raise ValueError(f"p_values={p_values[place]}: must be in [0, 1]")
    for rank, place in enumerate(sorted(tested, key=lambda k: p_values[k])):
        floor = max(floor, min(1.0, (len(tested) - rank) * p_values[place]))
        corrected[place] = floor
    return corrected


def paired_difference(
    first: Sequence[float],
    second: Sequence[float],
    confidence: float = 0.95,
    resamples: int = _RESAMPLES,
) -> PairedDifference:
    """Return the mean of first - second over the same episodes, with a sign-flip test.

    Pairing removes the variation of difficulty between episodes.

    Args:
        first: Finite values, one per episode.
        second: Finite values of the same episodes in the same order.
        confidence: Level in (0, 1).
        resamples: Number of bootstrap resamples of the episodes.

    Returns:
        Difference; the interval of :func:`bootstrap_mean`; and the p-value that the two runs are
        exchangeable in each episode: all sign flips for up to 12 pairs, 9,999 random ones for more.

    Raises:
        ValueError: If the numbers of episodes differ, or a value is not finite.

    Reference:
        :mod:`navrl.evaluation.sign_flips`.
    """
    _check_pairs(first, second)
    one, other = _finite("first", first), _finite("second", second)
    differences = one - other
    differences[np.isclose(one, other, rtol=1e-12, atol=0.0)] = 0.0  # equal but for rounding
    value, low, high, pairs = bootstrap_mean(differences, confidence, resamples)
    p_value = sign_flip_p_value(differences, _SEED) if pairs >= MIN_PAIRS else math.nan
    return PairedDifference(value, low, high, p_value, pairs)


def interquartile_mean(scores: np.ndarray) -> float:
    """Return the mean of the middle half of all ``scores``, of any shape.

    It is robust to outlying runs like the median, but uses more of the data.

    Raises:
        ValueError: If there is no score, or one is not finite.

    Reference:
        Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice",
        2021, Sec. 4.3.
    """
    sample = _finite("scores", scores)
    if sample.size == 0:
        raise ValueError("scores=[]: must have at least one score")
    return float(trim_mean(sample, 0.25, axis=None))


def stratified_bootstrap(
    scores: np.ndarray, confidence: float = 0.95, resamples: int = _RESAMPLES
) -> Estimate:
    """Return the interquartile mean over training seeds and tasks, with its interval.

    Args:
        scores: ``[R, M]``, of R training runs (seeds) on M tasks, such as kinds of worlds.
        confidence: Level in (0, 1).
        resamples: Number of bootstrap resamples, which draw runs with replacement for each task.

    Returns:
        Interquartile mean of all R x M scores, percentile interval, and R. The interval is NaN for
        fewer than :data:`MIN_SEEDS` runs and if all resamples are equal, since the spread is
        unknown.

    Raises:
        ValueError: If ``scores`` is not ``[R, M]`` with at least one score, all finite.

    Reference:
        Agarwal et al. 2021, Sec. 4.1 and 4.3; as in their library, rliable.
    """
    scores = np.asarray(scores, dtype=float)
    if scores.ndim != 2 or scores.size == 0 or not np.isfinite(scores).all():
        raise ValueError(
            f"scores.shape={list(scores.shape)}: must be [runs, tasks] of finite numbers"
        )
    value, (runs, tasks) = interquartile_mean(scores), scores.shape
    if runs < MIN_SEEDS:
        return Estimate(value, *_UNKNOWN, runs)
    rows = np.random.default_rng(_SEED).integers(runs, size=(resamples, runs, tasks))
    drawn = np.take_along_axis(scores[None], rows, axis=1).reshape(resamples, -1)
    means = trim_mean(drawn, 0.25, axis=1)
    tail = 50 * (1 - confidence)
    low, high = np.percentile(means, [tail, 100 - tail])
    return Estimate(value, *_with_width(float(low), float(high)), runs)


def _mean_interval(sample: np.ndarray, confidence: float, resamples: int) -> tuple[float, float]:
    """Return the interval of a mean; (nan, nan) if the spread of the sample is unknown."""
    if len(sample) < MIN_PAIRS or np.ptp(sample) == 0:
        return _UNKNOWN
    if len(sample) <= _MAX_SMALL_SAMPLE:
        return _with_width(*center_interval(sample, confidence, _SEED))
    interval = bootstrap(
        (sample,),
        np.mean,
        n_resamples=resamples,
        confidence_level=confidence,
        method="percentile",
        vectorized=True,
        batch=200,
        rng=np.random.default_rng(_SEED),
    ).confidence_interval
    return _with_width(float(interval.low), float(interval.high))


def _with_width(low: float, high: float) -> tuple[float, float]:
    """Return an interval, but (nan, nan) for one of zero width, whose spread is unknown."""
    return (low, high) if high > low else _UNKNOWN


def _finite(name: str, values: Sequence[float] | np.ndarray) -> np.ndarray:
    array = np.asarray(values, dtype=float)
    if not np.isfinite(array).all():
        raise ValueError(f"{name}={array[~np.isfinite(array)][0]}: must be finite")
    return array


def _check_pairs(first: Sequence, second: Sequence) -> None:
    if len(first) != len(second):
        raise ValueError(f"must be the same episodes, got {len(first)} and {len(second)}")


def p_value_text(value: float | None) -> str:
    """Return ``< 0.001`` or three decimals; a dash without a test."""
    if value is None or math.isnan(value):
        return "\N{EN DASH}"
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def interval_text(low: float, high: float, form: str) -> str:
    """Return ``" [low, high]"`` in a format, or an empty text for an unknown interval."""
    return "" if math.isnan(low) else f" [{low:{form}}, {high:{form}}]"
