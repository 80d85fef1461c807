"""Rates and means with their uncertainty."""

from __future__ import annotations

import math

from scipy.stats import binomtest


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
