"""The turn between two scans: :func:`navrl.ops.rotation_search.rotation_search` for one pair."""

import math

import numpy as np

from navrl.ops.kernels.compiler import reordering_scalar, scalar
from navrl.ops.kernels.nearest import FAR
from navrl.ops.rotation_search import PROFILE_CAP_M

_CAP = np.float32(PROFILE_CAP_M)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_TURN = 2.0 * math.pi


@scalar
def write_profile(rows, profile):
    """Write ranges to ``profile``, in as many rounds as it holds; FAR where nothing was seen."""
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


@scalar
def largest_shift(search_range, count):
    """Return how many points a scan may be turned by to either side."""
    return min(int(search_range / _TURN * count), count // 2)


@scalar
def search_rotation(source, target, search_range):
    """Return the yaw at which the range profiles of two scans [3, N] agree best."""
    count = source.shape[1]
    source_profile = np.empty(count, dtype=np.float32)
    profile = np.empty(3 * count, dtype=np.float32)
    write_profile(source, source_profile)
    write_profile(target, profile)
    max_shift = largest_shift(search_range, count)
    costs = np.empty(2 * max_shift + 1, dtype=np.float32)
    for column in range(costs.shape[0]):
        start = count - max_shift + column
        costs[column] = profile_cost(source_profile, profile[start : start + count])
    return best_shift(costs) * (_TURN / count)


@scalar
def best_shift(costs):
    """Return which of the shifts ``-max .. max`` costs least; the smaller one wins a tie."""
    middle = costs.shape[0] // 2
    best, shift = costs[middle], 0
    for size in range(1, middle + 1):
        for candidate in (-size, size):
            if costs[middle + candidate] < best:
                best, shift = costs[middle + candidate], candidate
    return shift
