"""Sign-flip test and confidence interval of a center, exact for few values.

If values are symmetric about a center, flipping the sign of any subset of them (minus the center)
is as likely as the observation. Flipping a subset changes the sum by twice the subset's sum, so
both the test and the interval that inverts it follow from the sums over subsets.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

_MAX_EXACT = 12  # values whose 4,096 subsets are all evaluated
_SUBSETS = 9_999  # random subsets for more; p-values are multiples of 1 / 10,000
_BATCH = 512  # random subsets per batch: 1,000 values take 4 MB


def sign_flip_p_value(values: np.ndarray, seed: int) -> float:
    """Return the two-sided p-value of the hypothesis that values are symmetric about zero.

    Args:
        values: ``[n]`` finite, at least one, such as differences between pairs.
        seed: Seed of the random subsets for n above 12.

    Returns:
        Twice the smaller share of sign flips with a mean at least as far to either side, at most 1.

    Reference:
        Fisher, "The Design of Experiments", 1935, Sec. 21; Phipson and Smyth, "Permutation p-values
        should never be zero", 2010, for the drawn ones.
    """
    sums, _ = _subset_sums(values, seed)
    tolerance = 1e-12 * np.abs(values).sum()  # sums that differ by rounding alone are ties
    tails = 1 + min((sums <= tolerance).sum(), (sums >= -tolerance).sum())
    return min(1.0, float(2 * tails / (len(sums) + 1)))


def center_interval(values: np.ndarray, confidence: float, seed: int) -> tuple[float, float]:
    """Return the interval of centers that :func:`sign_flip_p_value` does not reject.

    Args:
        values: ``[n]`` finite, at least 6 for a confidence of 0.95.
        confidence: Level in (0, 1).
        seed: Seed, as for the test.

    Returns:
        (low, high); (nan, nan) if n is too small for the level.

    Reference:
        Hartigan, "Using subsample values as typical values", 1969.
    """
    sums, sizes = _subset_sums(values, seed)
    rank = math.floor((1 - confidence) / 2 * (len(sums) + 1) + 1e-9)
    if rank < 1:
        return math.nan, math.nan
    means = np.sort(sums / sizes)
    return float(means[rank - 1]), float(means[-rank])


def _subset_sums(values: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return sums and sizes of all non-empty subsets, or of many random ones."""
    if len(values) <= _MAX_EXACT:
        members = np.array(list(product((0, 1), repeat=len(values)))[1:])
        return members @ values, members.sum(axis=1)
    rng, sums, sizes = np.random.default_rng(seed), [], []
    for start in range(0, _SUBSETS, _BATCH):
        count = min(_BATCH, _SUBSETS - start)
        members = rng.integers(0, 2, (count, len(values)), dtype=np.int8)
        members[~members.any(axis=1), 0] = 1
        sums.append(members @ values)
        sizes.append(members.sum(axis=1, dtype=np.int64))
    return np.concatenate(sums), np.concatenate(sizes)
