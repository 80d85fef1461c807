"""Projection of scan points to ranges, and to bearing bins, in another frame."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navrl.ops.backend import as_real
from navrl.ops.beams import RETURN_MARGIN_M
from navrl.ops.exporting import cumulative_maximum, cumulative_minimum, is_exporting
from navrl.ops.lines import REACH_M
from navrl.ops.scan_layout import bin_centers

_FOLDS = (torch.minimum, torch.maximum)


def project_ranges(
    points: Tensor, fill: Tensor, group_size: int | None = 8, max_range: float = 3.5
) -> Tensor:
    """Return the range of the nearest point in each bearing bin.

    Args:
        points: ``[*B, N, 2]`` m, in the frame of the returned ranges. Points of bins without a
            return mark a free direction and are projected like all others.
        fill: ``[*B, N]`` m, broadcast: range of a bin without points. With the ranges of the
            current scan, a direction that was not observed before appears static.
        group_size: Beams per bin, so that the N bins are those of
            :func:`navrl.ops.pooling.min_pool`; None for bins of any number of beams.
        max_range: Largest returned range, m.

    Returns:
        ``[*B, N]`` m. Points that are not finite are ignored.

    Raises:
        ValueError: If the shapes are invalid.

    Example:
        >>> points = torch.tensor([[1.0, 0.1], [-2.0, -0.1]])
        >>> project_ranges(points, torch.full((2,), 3.5), group_size=None).round(decimals=3)
        tensor([1.0050, 2.0020])
    """
    if points.ndim < 2 or points.shape[-1] != 2 or fill.shape[-1:] != points.shape[-2:-1]:
        raise ValueError(
            f"points, fill: must have shapes [*B, N, 2] and [*B, N], "
            f"got {tuple(points.shape)} and {tuple(fill.shape)}"
        )
    points, fill = as_real(points), as_real(fill)
    distance = torch.linalg.vector_norm(points, dim=-1)
    is_finite = distance.isfinite()
    distance = distance.clamp(max=max_range)
    index = bearing_bins(points, group_size)
    empty = torch.full_like(distance, math.inf)
    nearest = empty.scatter_reduce(-1, index, torch.where(is_finite, distance, math.inf), "amin")
    return torch.where(nearest.isfinite(), nearest, fill)


def bearing_bins(points: Tensor, group_size: int | None = 8) -> Tensor:
    """Return the bearing bin of each point.

    Args:
        points: ``[*B, N, 2]`` m, robot frame; the number of bins is N.
        group_size: Beams per bin; see :func:`project_ranges`.

    Returns:
        ``[*B, N]`` int64; any bin for a point that is not finite.

    Example:
        >>> bearing_bins(torch.tensor([[1.0, 0.1], [-2.0, -0.1]]), group_size=None)
        tensor([0, 1])
    """
    num_bins = points.shape[-2]
    first = bin_bearings(num_bins, group_size, points.dtype, points.device)[0]
    bearing = torch.atan2(points[..., 1], points[..., 0]) - first
    return (bearing * (num_bins / (2.0 * math.pi))).round().nan_to_num().long() % num_bins


def bin_bearings(
    num_bins: int,
    group_size: int | None,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
) -> Tensor:
    """Return the bearing of each bin's center, ``[N]`` rad.

    Example:
        >>> bin_bearings(2, group_size=None)
        tensor([1.5708, 4.7124])
    """
    if group_size is not None:
        return bin_centers(num_bins * group_size, group_size, dtype, device)
    row = torch.arange(num_bins, dtype=dtype, device=device)
    return (row + 0.5) * (2.0 * math.pi / num_bins)


class BinnedScan(NamedTuple):
    """Result of :func:`rebin_scan`, ordered by bearing as :func:`navrl.ops.pooling.min_pool`."""

    ranges: Tensor
    """``[*B, N]`` m, distance of the nearest return of each bin, ``max_range`` if it has none."""
    points: Tensor
    """``[*B, N, 2]`` m; the point of a bin without a return is at ``max_range`` on its center."""
    returns: Tensor
    """``[*B, N]`` bool, whether the bin has a return."""
    seen: Tensor
    """``[*B, N]`` bool, whether a ray fell into the bin or, in a gap, beside it."""


def rebin_scan(
    points: Tensor,
    returns: Tensor,
    group_size: int | None = 8,
    max_range: float = 3.5,
    seen: Tensor | None = None,
) -> BinnedScan:
    """Order points that were moved to another frame by bearing, one point per bin.

    A bin takes its nearest return, at the position where it is. A bin that only rays without a
    return reach is free. The motion spreads some points, which leaves single bins that no ray
    reaches: such a gap lies on the line between its neighbors to the left and right if both are
    returns within 0.4 m, and else has the smaller of their ranges, so that a wall stays closed.

    Args:
        points: ``[*B, N, 2]`` m, in the frame of the result. A point without a return only gives
            the direction of its ray.
        returns: ``[*B, N]`` bool. Returns at ``max_range`` or beyond, or not finite, are none.
        group_size: Beams per bin; see :func:`project_ranges`.
        max_range: Range of the sensor, m.
        seen: ``[*B, N]`` bool, rays that the lidar covers; None for all. The others are ignored
            unless no covered ray is as near to a bin.

    Returns:
        The scan of N bins.

    Raises:
        ValueError: If the shapes are invalid.

    Example:
        >>> points = torch.tensor([[1.0, -0.1], [-2.0, 0.1]])
        >>> scan = rebin_scan(points, torch.tensor([True, True]), group_size=None)
        >>> scan.points
        tensor([[-2.0000,  0.1000],
                [ 1.0000, -0.1000]])

    Reference:
        Not in the paper.
    """
    if points.ndim < 2 or points.shape[-1] != 2 or returns.shape != points.shape[:-1]:
        raise ValueError(
            f"points, returns: must have shapes [*B, N, 2] and [*B, N], "
            f"got {tuple(points.shape)} and {tuple(returns.shape)}"
        )
    points = as_real(points)
    distance = torch.linalg.vector_norm(points, dim=-1)
    returns = returns & (distance < max_range - RETURN_MARGIN_M)  # False for NaN
    # a return comes before a free ray, and a free ray before one outside of the field of view
    free, blind = max_range, max_range + 1.0
    order = torch.where(returns, distance, free)
    if seen is not None:
        order = torch.where(seen, order, blind)
    order = torch.where(distance.isfinite(), order, blind)
    ray = _nearest_ray(order, bearing_bins(points, group_size))
    bearing = bin_bearings(points.shape[-2], group_size, points.dtype, points.device)
    center = torch.stack((bearing.cos(), bearing.sin()), dim=-1)
    left, right = nearest_filled(ray)
    reach = torch.minimum(order.gather(-1, left), order.gather(-1, right))
    is_gap = ray < 0
    if is_exporting() or bool(is_gap.any()):
        start, end = (
            points.gather(-2, side.unsqueeze(-1).expand_as(points)) for side in (left, right)
        )
        are_returns = returns.gather(-1, left) & returns.gather(-1, right) & (reach < free)
        reach = torch.where(are_returns & is_gap, _on_line(start, end, center, reach), reach)
    is_return = reach < free
    nearest = points.gather(-2, left.unsqueeze(-1).expand_as(points))
    on_center = reach.clamp(max=max_range).unsqueeze(-1) * center
    chosen = torch.where((is_return & ~is_gap).unsqueeze(-1), nearest, on_center)
    return BinnedScan(reach.clamp(max=max_range), chosen, is_return, reach < blind)


def _nearest_ray(order: Tensor, index: Tensor) -> Tensor:
    """Return the ray ``[*B, N]`` of the smallest ``order`` in each bin, -1 for an empty bin."""
    empty = torch.full_like(order, math.inf)
    first = empty.scatter_reduce(-1, index, order, "amin").gather(-1, index)
    ray = torch.arange(order.shape[-1], device=order.device).expand_as(index)
    ray = torch.where(order == first, ray, -1)
    return torch.full_like(index, -1).scatter_reduce(-1, index, ray, "amax")


def nearest_filled(ray: Tensor) -> tuple[Tensor, Tensor]:
    """Return the rays of the nearest filled bins to either side; a filled bin's own for both.

    Args:
        ray: ``[*B, N]`` int64, ray of each bin of the full circle, negative for an empty bin.

    Returns:
        The rays to the right and to the left, ``[*B, N]`` each.

    Example:
        >>> right, left = nearest_filled(torch.tensor([5, -1, 7, -1]))
        >>> right, left
        (tensor([5, 5, 7, 7]), tensor([5, 7, 7, 5]))
    """
    num_bins = ray.shape[-1]
    row = torch.arange(3 * num_bins, device=ray.device)
    filled = torch.cat([ray, ray, ray], dim=-1) >= 0  # the bins close around the robot
    before = cumulative_maximum(torch.where(filled, row, -1))
    after = cumulative_minimum(torch.where(filled, row, 3 * num_bins).flip(-1)).flip(-1)
    middle = slice(num_bins, 2 * num_bins)
    left, right = (ray.gather(-1, side[..., middle] % num_bins) for side in (before, after))
    return left, right


def _on_line(left: Tensor, right: Tensor, direction: Tensor, default: Tensor) -> Tensor:
    """Return the range at which each ray meets the line between near neighbors."""
    x, y = (right - left).unbind(-1)
    across = direction[..., 0] * y - direction[..., 1] * x
    reach = (left[..., 0] * y - left[..., 1] * x) / across
    lower, upper = (fold(left.norm(dim=-1), right.norm(dim=-1)) for fold in _FOLDS)
    is_near = (torch.hypot(x, y) < REACH_M) & reach.isfinite()
    # between almost aligned neighbors the line is steep and its range only bounded by theirs
    return torch.where(is_near, reach.clamp(lower, upper), default)
