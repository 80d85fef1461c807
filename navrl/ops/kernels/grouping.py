"""Group descriptors: float64 kernel of :func:`navrl.ops.grouping.tagd` per pair of scans."""

import functools
import math

import numpy as np
import torch
from torch import Tensor

from navrl.ops.beams import SECTOR_TOLERANCE_RAD
from navrl.ops.kernels.compiler import kernel, reordering_scalar, scalar
from navrl.ops.kernels.operators import operator

FAR = 1e9  # m; coordinate of points without a return
_TWO_PI = 2.0 * math.pi


@scalar
def write_rows(points, returns, rows):
    """Write x, y and distance to ``rows`` [3, N], FAR for points without a finite return.

    Two loops without a branch, so that the compiler vectorizes both.
    """
    xs, ys, distances = rows[0], rows[1], rows[2]
    for index in range(returns.shape[0]):
        xs[index], ys[index] = points[index, 0], points[index, 1]
    for index in range(returns.shape[0]):
        x, y = xs[index], ys[index]
        distance = math.sqrt(x * x + y * y) + (0.0 if returns[index] else math.inf)
        is_return = distance < math.inf  # also False for NaN
        xs[index] = x if is_return else FAR
        ys[index] = y if is_return else FAR
        distances[index] = distance if is_return else FAR


@scalar
def has_return(rows):
    """Return whether any of the points is a return."""
    for index in range(rows.shape[1]):  # noqa: SIM110, kernels have no any()
        if rows[2, index] < FAR:
            return True
    return False


@reordering_scalar
def clipped(x, y, distance, ray_x, ray_y, cos_half_sector, max_range):
    """Return the distance of a point, at most ``max_range``; ``max_range`` outside the sector."""
    along = x * ray_x + y * ray_y
    is_inside = (along >= cos_half_sector * distance) & (distance < max_range)
    return distance if is_inside else max_range


@scalar
def nearest_ray(x, y, rays, ray):
    """Return the ray with the smallest angle to a point, by local search from ``ray``."""
    along = x * rays[ray, 0] + y * rays[ray, 1]
    while True:
        is_left = rays[ray, 0] * y - rays[ray, 1] * x > 0.0
        candidate = ray + 1 if is_left else ray - 1
        candidate = 0 if candidate == rays.shape[0] else candidate
        candidate = rays.shape[0] - 1 if candidate < 0 else candidate
        candidate_along = x * rays[candidate, 0] + y * rays[candidate, 1]
        if candidate_along <= along:
            return ray
        ray, along = candidate, candidate_along


@scalar
def write_reaches(rows, rays, cosine, max_range, reaches):
    """Write the distance of the nearest point in the sector of each ray, ``max_range`` if none.

    Points are in scan order, so most are in the sector of their predecessor. A point near a border
    can be in three sectors: those of the nearest ray and of its two neighbors.
    """
    num_rays, ray = rays.shape[0], 0
    border = math.cos(math.acos(cosine) - 2.0 * SECTOR_TOLERANCE_RAD)
    reaches[:] = max_range
    for index in range(rows.shape[1]):
        x, y, distance = rows[0, index], rows[1, index], rows[2, index]
        if distance >= max_range:
            continue
        if x * rays[ray, 0] + y * rays[ray, 1] < border * distance:
            ray = nearest_ray(x, y, rays, ray)
        if x * rays[ray, 0] + y * rays[ray, 1] >= border * distance:
            reaches[ray] = min(reaches[ray], distance)
            continue
        for offset in range(-1, 2):
            other = (ray + offset) % num_rays
            reach = clipped(x, y, distance, rays[other, 0], rays[other, 1], cosine, max_range)
            reaches[other] = min(reaches[other], reach)


@reordering_scalar
def sum_members(rows, center_x, center_y, radius_squared):
    """Return the number of points within the radius and the sums of their offsets."""
    x, y = rows[0], rows[1]
    number, sum_x, sum_y = 0.0, 0.0, 0.0
    for index in range(x.shape[0]):
        dx, dy = x[index] - center_x, y[index] - center_y
        weight = 1.0 if dx * dx + dy * dy <= radius_squared else 0.0
        number += weight
        sum_x += weight * dx
        sum_y += weight * dy
    return number, sum_x, sum_y


@scalar
def describe(
    now, before, ray_x, ray_y, reach, radius, now_is_center, previous_fill, descriptor, valid
):
    """Write the descriptor [4] and validity [2] of the group at ``reach`` on a ray."""
    gx, gy = reach * ray_x, reach * ray_y
    x, y = (gx, gy) if now_is_center else (0.0, 0.0)
    number, sum_x, sum_y = sum_members(now, gx, gy, radius * radius)
    valid[1] = number > 0.0
    if number > 0.0:
        x, y = gx + sum_x / number, gy + sum_y / number
    old_x, old_y = (x, y) if previous_fill == 0 else (0.0, 0.0)
    old_x, old_y = (gx, gy) if previous_fill == 1 else (old_x, old_y)
    number, sum_x, sum_y = sum_members(before, gx, gy, radius * radius)
    valid[0] = number > 0.0
    if number > 0.0:
        old_x, old_y = gx + sum_x / number, gy + sum_y / number
    descriptor[0], descriptor[1], descriptor[2], descriptor[3] = old_x, old_y, x, y


@scalar
def cos_half_sector(num_groups):
    """Return the cosine of the angle from a ray to the border of its sector."""
    return math.cos(min(math.pi / num_groups + SECTOR_TOLERANCE_RAD, math.pi))


@kernel
def tagd_kernel(
    rows, points, returns, previous_points, previous_returns, rays, radius, max_range,
    now_is_center, previous_fill, zero_without_returns, descriptors, valid,
):  # fmt: skip
    """Write descriptors [S, N_c, 4] and their validity [S, N_c, 2]; ``rays`` is [N_c, 2].

    ``previous_fill`` is 0 for the current centroid, 1 for the group center, 2 for zeros.
    """
    num_groups = rays.shape[0]
    cosine = cos_half_sector(num_groups)
    for n in range(rows[0], rows[1]):
        now, before = np.empty((3, points.shape[1])), np.empty((3, previous_points.shape[1]))
        write_rows(points[n], returns[n], now)
        write_rows(previous_points[n], previous_returns[n], before)
        reaches = np.empty(num_groups)
        write_reaches(now, rays, cosine, max_range, reaches)
        for group in range(num_groups):
            describe(
                now, before, rays[group, 0], rays[group, 1], reaches[group], radius, now_is_center,
                previous_fill, descriptors[n, group], valid[n, group],
            )  # fmt: skip
        if zero_without_returns and not (has_return(now) or has_return(before)):
            descriptors[n] = 0.0


@functools.lru_cache(maxsize=16)
def _rays(num_groups: int, device: torch.device) -> Tensor:
    """Return the unit vectors of the rays [N_c, 2]."""
    angle = np.arange(num_groups) * (_TWO_PI / num_groups)
    return torch.from_numpy(np.stack((np.cos(angle), np.sin(angle)), axis=-1)).to(device)


def _described(
    points: Tensor, returns: Tensor, before: Tensor, had: Tensor, num_groups: int, *_: object
) -> tuple[Tensor, Tensor]:
    descriptors = points.new_empty(points.shape[0], num_groups, 4)
    return descriptors, points.new_empty(points.shape[0], num_groups, 2, dtype=torch.bool)


@operator(_described)
def describe_groups(
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
    """Run the kernel of :func:`navrl.ops.grouping.tagd` on scans [S, N, 2] and [S, M, 2]."""
    scans = (points, returns, previous_points, previous_returns)
    described = _described(*scans, num_groups)
    tagd_kernel(
        *(scan.contiguous() for scan in scans),
        _rays(num_groups, points.device),
        float(group_radius),
        float(max_range),
        empty_now == "center",
        ("current", "center", "zeros").index(empty_previous),
        empty_scans == "zeros",
        *described,
    )
    return described
