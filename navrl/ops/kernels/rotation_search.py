"""Kernel of :func:`navrl.ops.rotation_search.rotation_search` for one pair of scans."""

import math

import numpy as np

from navrl.ops.kernels.compiler import reordering_scalar, scalar
from navrl.ops.kernels.nearest import FAR
from navrl.ops.rotation_search import PROFILE_CAP_M

_CAP = np.float32(PROFILE_CAP_M)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_NOT_SEEN = np.float32(-1.0)  # marks uncovered bearings in a range profile
_TWO_PI = 2.0 * math.pi


@scalar
def write_profile(rows, profile):
    """Write ranges to ``profile``, repeated to its length; FAR for beams without a return."""
    count = rows.shape[1]
    for index in range(count):
        x, y = rows[0, index], rows[1, index]
        profile[index] = math.sqrt(x * x + y * y) + (1.0 - rows[2, index]) * FAR
    for column in range(count, profile.shape[0]):
        profile[column] = profile[column - count]


@reordering_scalar
def profile_cost(source, target):
    """Return the mean capped difference of two range profiles."""
    total, seen = _ZERO, _ZERO
    for index in range(source.shape[0]):
        difference = abs(source[index] - target[index])
        total += difference if difference < _CAP else _CAP
        seen += _ONE if (source[index] < FAR) | (target[index] < FAR) else _ZERO
    return total / (seen if seen > _ONE else _ONE)


@reordering_scalar
def profile_cost_seen(source, target):
    """Return :func:`profile_cost` if each beam has a return in at least one of the profiles."""
    total = _ZERO
    for index in range(source.shape[0]):
        difference = abs(source[index] - target[index])
        total += difference if difference < _CAP else _CAP
    return total / np.float32(source.shape[0])


@reordering_scalar
def profile_cost_covered(source, target):
    """Return :func:`profile_cost` over the bearings covered in both profiles."""
    total, seen = _ZERO, _ZERO
    for index in range(source.shape[0]):
        covered = _ONE if (source[index] >= _ZERO) & (target[index] >= _ZERO) else _ZERO
        difference = abs(source[index] - target[index])
        total += covered * (difference if difference < _CAP else _CAP)
        seen += covered if (source[index] < FAR) | (target[index] < FAR) else _ZERO
    return total / (seen if seen > _ONE else _ONE)


@scalar
def hide_unseen(seen, profile):
    """Mark the bearings that the scanner does not cover, in each repetition of ``profile``."""
    for column in range(profile.shape[0]):
        if not seen[column % seen.shape[0]]:
            profile[column] = _NOT_SEEN


@scalar
def has_no_miss(profile):
    """Return whether all beams have a return."""
    misses = 0
    for index in range(profile.shape[0]):
        misses += profile[index] >= FAR
    return misses == 0


@scalar
def largest_shift(search_range, count):
    """Return the largest shift to either side, in points."""
    return min(int(search_range / _TWO_PI * count), count // 2)


@scalar
def search_rotation(source, target, seen, is_partial, search_range):
    """Return the yaw at which the range profiles of two scans [3, N] agree best.

    If ``is_partial``, only bearings that are ``seen`` [N] are compared.
    """
    count = source.shape[1]
    source_profile = np.empty(count, dtype=np.float32)
    profile = np.empty(3 * count, dtype=np.float32)
    write_profile(source, source_profile)
    write_profile(target, profile)
    if is_partial:
        hide_unseen(seen, source_profile)
        hide_unseen(seen, profile)
    max_shift = largest_shift(search_range, count)
    costs = np.empty(2 * max_shift + 1, dtype=np.float32)
    all_seen = has_no_miss(source_profile) or has_no_miss(profile[:count])
    for column in range(costs.shape[0]):
        start = count - max_shift + column
        turned = profile[start : start + count]
        if is_partial:
            costs[column] = profile_cost_covered(source_profile, turned)
        elif all_seen:  # skips the count of valid beams, a third of the time
            costs[column] = profile_cost_seen(source_profile, turned)
        else:
            costs[column] = profile_cost(source_profile, turned)
    return best_shift(costs) * (_TWO_PI / count)


@scalar
def best_shift(costs):
    """Return the shift in ``-max .. max`` with the lowest cost; a tie selects the smaller one."""
    middle = costs.shape[0] // 2
    best, shift = costs[middle], 0
    for size in range(1, middle + 1):
        for candidate in (-size, size):
            if costs[middle + candidate] < best:
                best, shift = costs[middle + candidate], candidate
    return shift
