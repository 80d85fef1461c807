"""Min-pooling of a lidar scan to a few points that retain the nearest obstacles."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from navrl.checks import check_positive
from navrl.ops.backend import Backend, as_real, is_compiled
from navrl.ops.beams import RETURN_MARGIN_M, Bearing
from navrl.ops.scan_layout import TWO_PI, ScanLayout, scan_layout


class PooledScan(NamedTuple):
    """Result of :func:`min_pool`."""

    ranges: Tensor
    """``[*B, N]`` m, range of the nearest return of each bin, ``max_range`` if it has none."""
    points: Tensor
    """``[*B, N, 2]`` m, robot frame; the point of a bin without a return is at ``max_range``."""
    returns: Tensor
    """``[*B, N]`` bool, whether the bin contains a return."""


def min_pool(
    ranges: Tensor,
    group_size: int | None = 8,
    max_range: float = 3.5,
    bearing: Bearing = "bin",
    backend: Backend = "auto",
    *,
    num_points: int | None = None,
    angle_min: float = 0.0,
    angle_increment: float | None = None,
    mount: Sequence[float] = (0.0, 0.0, 0.0),
) -> PooledScan:
    """Reduce a scan to the nearest return in each of N equal bearing bins around the robot.

    The minimum is conservative: the nearest obstacle of the scan is always among the pooled points.
    A reading is a return if ``0 < r < max_range``. All other values (maximum range or more,
    infinity, NaN, zero or less, as drivers report a miss) are not returns, so an invalid beam does
    not affect its neighbors.

    The bins cover the full circle, independent of the scanner's field of view. A bin without beams
    has no return, like a free one; :meth:`navrl.ops.scan_layout.ScanLayout.seen` distinguishes the
    two. If the scanner is not mounted at the robot's center, ranges and bearings are measured from
    the robot's center, and points at ``max_range`` or beyond from there are not returns.

    Args:
        ranges: ``[*B, beams]`` m, beam j at ``angle_min + j * angle_increment`` counter-clockwise
            from the scanner's x axis. Integers are read as float32.
        group_size: Beams per bin; must divide the beams of a revolution. None with ``num_points``.
        max_range: Range of the sensor, in the unit of ``ranges``.
        bearing: Bearing of a pooled point: ``"bin"`` the center of its bin, ``"beam"`` that of the
            beam that measured it.
        backend: See :mod:`navrl.ops.backend`; all backends agree bit for bit. An off-center mount
            always uses the torch implementation.
        num_points: Number of bins N; None derives it from ``group_size``. If ``group_size`` is
            None, it need not divide the number of beams.
        angle_min: Bearing of beam 0 in the scanner's frame, rad.
        angle_increment: Angle between beams, rad, of either sign; None for a full circle.
        mount: (x, y, yaw) of the scanner in the robot frame, m and rad.

    Returns:
        The pooled scan of N points, ordered by bearing, bin 0 straight ahead.

    Raises:
        ValueError: If an argument is invalid; the message names it.

    Example:
        >>> min_pool(torch.tensor([1.0, 2.0, 3.5, 3.5]), group_size=2).ranges
        tensor([1.0000, 3.5000])

    Reference:
        Paper Sec. IV-G (1,440 beams) and IV-C (min-pooled to 180). The paper does not give the
        bearing of a pooled point; the bin's center follows the authors' precursor, and ``"beam"``
        is up to half a bin (0.9 deg) more accurate.
    """
    if ranges.ndim < 1 or ranges.shape[-1] < 1:
        raise ValueError(f"ranges: must have shape [*B, beams], got {tuple(ranges.shape)}")
    check_pooling(max_range, bearing)
    increment = None if angle_increment is None else float(angle_increment)
    beams = int(ranges.shape[-1])
    shape = (beams, group_size, num_points, float(angle_min), increment, tuple(mount))
    layout = scan_layout(*shape)
    ranges = as_real(ranges)
    if layout.mount[:2] != (0.0, 0.0):
        return _pool_from_center(ranges, layout, max_range, bearing)
    table = None if layout.is_plain else _flat_table(layout, ranges.device)
    if table is not None:  # reorder so that the beams of each bin are contiguous
        missing = ranges.new_full((*ranges.shape[:-1], 1), max_range)
        ranges = torch.cat([ranges, missing], dim=-1)[..., table]
    directions = _constant_directions(shape, bearing, ranges.dtype, ranges.device)
    if is_compiled(backend, ranges):
        return _min_pool_compiled(ranges, layout.num_bins, directions, max_range, bearing)
    cleaned = torch.where(_is_return(ranges, max_range), ranges, max_range)
    nearest, index = cleaned.unflatten(-1, (layout.num_bins, -1)).min(dim=-1)
    returns = nearest < max_range
    row = torch.arange(layout.num_bins, device=ranges.device)
    if bearing == "beam":
        size = ranges.shape[-1] // layout.num_bins
        row = torch.where(returns, layout.num_bins + row * size + index, row)
    return PooledScan(nearest, nearest.unsqueeze(-1) * directions[row], returns)


def check_pooling(max_range: float, bearing: Bearing = "bin") -> None:
    """Check ``max_range`` and ``bearing`` of :func:`min_pool`.

    Raises:
        ValueError: If ``max_range`` is not positive or ``bearing`` is unknown.
    """
    check_positive(max_range=max_range)
    if max_range <= RETURN_MARGIN_M:
        raise ValueError(f"max_range={max_range}: must be above {RETURN_MARGIN_M} (m)")
    if bearing not in ("bin", "beam"):
        raise ValueError(f"bearing={bearing!r}: must be 'bin' or 'beam'")


def _is_return(ranges: Tensor, max_range: float) -> Tensor:
    return (ranges > 0.0) & (ranges < max_range - RETURN_MARGIN_M)  # False for NaN


def _min_pool_compiled(
    ranges: Tensor, num_bins: int, directions: Tensor, max_range: float, bearing: Bearing
) -> PooledScan:
    from navrl.ops.kernels.pooling import pool

    batch = ranges.shape[:-1]
    flat = ranges.reshape(batch.numel(), ranges.shape[-1])
    pooled = pool(flat, num_bins, directions, max_range, bearing)
    return PooledScan(*(values.reshape(batch + values.shape[1:]) for values in pooled))


def _pool_from_center(
    ranges: Tensor, layout: ScanLayout, max_range: float, bearing: Bearing
) -> PooledScan:
    """Pool the readings of an off-center scanner by range and bearing from the robot's center."""
    direction = _unit_vectors(layout.beam_bearings()).to(ranges)
    hits = ranges.unsqueeze(-1) * direction + ranges.new_tensor(layout.mount[:2])
    distance = torch.linalg.vector_norm(hits, dim=-1)
    is_return = _is_return(ranges, max_range) & (distance < max_range - RETURN_MARGIN_M)
    distance = torch.where(is_return, distance, max_range)
    index = layout.bin_of(torch.atan2(hits[..., 1], hits[..., 0]).nan_to_num().double())
    bins = (*ranges.shape[:-1], layout.num_bins)
    nearest = distance.new_full(bins, max_range).scatter_reduce(-1, index, distance, "amin")
    returns = nearest < max_range
    centers = _unit_vectors(layout.bin_centers(ranges.dtype, ranges.device))
    points = nearest.unsqueeze(-1) * centers
    if bearing == "beam":
        is_nearest = is_return & (distance == nearest.gather(-1, index))
        beam = torch.arange(layout.num_beams, device=ranges.device).expand_as(index)
        beam = torch.where(is_nearest, beam, layout.num_beams - 1)
        last = torch.full(bins, layout.num_beams - 1, device=ranges.device)
        first = last.scatter_reduce(-1, index, beam, "amin")
        measured = hits.gather(-2, first.unsqueeze(-1).expand(*first.shape, 2))
        points = torch.where(returns.unsqueeze(-1), measured, points)
    return PooledScan(nearest, points, returns)


@functools.lru_cache(maxsize=16)
def _flat_table(layout: ScanLayout, device: torch.device) -> Tensor:
    return layout.beams_by_bin().flatten().to(device)


@torch.compiler.assume_constant_result  # a compiled graph does not compute it in each call
def _constant_directions(
    shape: tuple, bearing: Bearing, dtype: torch.dtype, device: torch.device
) -> Tensor:
    """Return :func:`_directions`; ``shape`` has the arguments of :func:`scan_layout`."""
    return _directions(scan_layout(*shape), bearing, dtype, device)


@functools.lru_cache(maxsize=16)
def _directions(
    layout: ScanLayout, bearing: Bearing, dtype: torch.dtype, device: torch.device
) -> Tensor:
    """Return the unit vectors of the bins ``[N, 2]`` and, if needed, those of all beams.

    The N * M beams are ordered as in :meth:`ScanLayout.beams_by_bin`.
    """
    angle = layout.bin_centers(dtype)
    size = layout.group_size if layout.is_plain else None
    if bearing == "beam" and size is not None:
        offset = torch.arange(layout.num_beams).remainder(size).to(dtype) - 0.5 * (size - 1)
        each = angle.repeat_interleave(size) + offset * (TWO_PI / layout.num_beams)
        angle = torch.cat((angle, each))
    elif bearing == "beam":
        each = torch.nn.functional.pad(layout.beam_bearings(), (0, 1))
        angle = torch.cat((angle, each[layout.beams_by_bin().flatten()].to(dtype)))
    return _unit_vectors(angle).to(device)


def _unit_vectors(angle: Tensor) -> Tensor:
    return torch.stack((angle.cos(), angle.sin()), dim=-1)
