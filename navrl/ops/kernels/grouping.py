"""Group descriptors: :func:`navrl.ops.grouping.tagd`, pair of scans by pair, in float64."""

import math

import numpy as np
import torch
from numba import prange
from torch import Tensor

from navrl.ops.grouping import SECTOR_TOLERANCE_RAD
from navrl.ops.kernels.compiler import kernel, reordering_scalar, scalar

_FAR = 1e9  # m; where points that are no returns are put
_TURN = 2.0 * math.pi


@scalar
def write_coordinates(points, returns, coordinates):
    """Write x and y to ``coordinates`` [2, N]; return whether there is any return."""
    any_return = False
    for index in range(returns.shape[0]):
        is_return = returns[index]
        any_return |= is_return
        coordinates[0, index] = points[index, 0] if is_return else _FAR
        coordinates[1, index] = points[index, 1] if is_return else _FAR
    return any_return


@scalar
def write_reaches(coordinates, max_range, reaches):
    """Write the distance of the nearest return in each sector to ``reaches`` [N_c]."""
    num_groups = reaches.shape[0]
    reaches[:] = max_range
    sector = _TURN / num_groups
    half_sector = 0.5 * sector + SECTOR_TOLERANCE_RAD
    for index in range(coordinates.shape[1]):
        x, y = coordinates[0, index], coordinates[1, index]
        if x == _FAR:
            continue
        bearing = math.atan2(y, x)
        if bearing < 0.0:
            bearing += _TURN
        distance = math.sqrt(x * x + y * y)
        low = int(bearing / sector)
        for ray in (low, low + 1):
            if abs(bearing - ray * sector) <= half_sector and distance < reaches[ray % num_groups]:
                reaches[ray % num_groups] = distance


@reordering_scalar
def sum_members(x, y, center_x, center_y, radius_squared):
    """Return how many points lie within the radius of the centre, and the sums of x and y."""
    number, sum_x, sum_y = 0.0, 0.0, 0.0
    for index in range(x.shape[0]):
        dx, dy = x[index] - center_x, y[index] - center_y
        is_member = dx * dx + dy * dy <= radius_squared
        number += 1.0 if is_member else 0.0
        sum_x += x[index] if is_member else 0.0
        sum_y += y[index] if is_member else 0.0
    return number, sum_x, sum_y


@kernel
def tagd_kernel(
    points, returns, previous_points, previous_returns, rays, radius, max_range,
    now_is_center, previous_fill, zero_without_returns, descriptors, valid,
):  # fmt: skip
    """Write descriptors [S, N_c, 4] and their validity [S, N_c, 2]; ``rays`` is [N_c, 2].

    ``previous_fill`` is 0 for the current centroid, 1 for the group's centre, 2 for zeros.
    """
    num_groups = rays.shape[0]
    for n in prange(points.shape[0]):
        now = np.empty((2, points.shape[1]), dtype=np.float64)
        before = np.empty((2, previous_points.shape[1]), dtype=np.float64)
        reaches = np.empty(num_groups, dtype=np.float64)
        has_now = write_coordinates(points[n], returns[n], now)
        has_before = write_coordinates(previous_points[n], previous_returns[n], before)
        write_reaches(now, max_range, reaches)
        for group in range(num_groups):
            gx, gy = reaches[group] * rays[group, 0], reaches[group] * rays[group, 1]
            number, x, y = sum_members(now[0], now[1], gx, gy, radius * radius)
            valid[n, group, 1] = number > 0.0
            fill_x, fill_y = (gx, gy) if now_is_center else (0.0, 0.0)
            x, y = (x / number, y / number) if number > 0.0 else (fill_x, fill_y)
            number, old_x, old_y = sum_members(before[0], before[1], gx, gy, radius * radius)
            valid[n, group, 0] = number > 0.0
            if number > 0.0:
                old_x, old_y = old_x / number, old_y / number
            elif previous_fill == 0:
                old_x, old_y = x, y
            elif previous_fill == 1:
                old_x, old_y = gx, gy
            descriptors[n, group, 0], descriptors[n, group, 1] = old_x, old_y
            descriptors[n, group, 2], descriptors[n, group, 3] = x, y
        if zero_without_returns and not (has_now or has_before):
            descriptors[n] = 0.0


def tagd_cpu(
    points: Tensor,
    returns: Tensor,
    previous_points: Tensor,
    previous_returns: Tensor,
    num_groups: int,
    group_radius: float,
    max_range: float,
    empty_now: str,
    empty_previous: str,
    empty_scans: str,
) -> tuple[Tensor, Tensor]:
    """Kernel behind :func:`navrl.ops.grouping.tagd`: scans [S, N, 2] and [S, M, 2] in."""
    descriptors = points.new_empty(points.shape[0], num_groups, 4)
    valid = torch.empty(points.shape[0], num_groups, 2, dtype=torch.bool)
    angle = np.arange(num_groups) * (_TURN / num_groups)
    scans = (points, returns, previous_points, previous_returns)
    tagd_kernel(
        *(scan.detach().contiguous().numpy() for scan in scans),
        np.stack((np.cos(angle), np.sin(angle)), axis=-1),
        float(group_radius),
        float(max_range),
        empty_now == "center",
        ("current", "center", "zeros").index(empty_previous),
        empty_scans == "zeros",
        descriptors.numpy(),
        valid.numpy(),
    )
    return descriptors, valid
