"""Resampling of any lidar's scan to the beams that a policy was trained with."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navrl.ops import se2
from navrl.ops.backend import as_real
from navrl.ops.exporting import is_exporting
from navrl.ops.projection import nearest_filled
from navrl.ops.scan_layout import ScanLayout
from navrl.ops.scanner import BeamState, Scanner

_ROUNDING = 1e-6  # beams; the border between two beams belongs to both
_MAX_WIDENING = 3.0  # apparent width of a beam seen from nearer, in beams of the scanner


class AdaptedScan(NamedTuple):
    """Result of :func:`adapt_scan`."""

    ranges: Tensor
    """``[*B, N]`` float32 m from the target's center; +inf if free, NaN if not seen, the distance
    at the scanner's ``range_min`` if too near."""
    states: Tensor
    """``[*B, N]`` int64, codes of :class:`navrl.ops.scanner.BeamState`."""


class _Rays(NamedTuple):
    """Beams of a scan in the frame of the target layout, ``[*B, M]`` each, float64."""

    states: Tensor
    direction: Tensor  # rad, at an infinite range
    bearing: Tensor  # rad, of the point that was measured
    distance: Tensor  # m
    width: Tensor  # rad


def adapt_scan(
    ranges: Tensor, scanner: Scanner, target: ScanLayout, scan_motion: Tensor | None = None
) -> AdaptedScan:
    """Resample a scan to the beams of another layout, by bearing.

    Each beam of the scanner stands for the angle of one increment. A beam of the target has the
    nearest return of the scanner's beams that cover it; if the scanner is finer, each of its beams
    counts for the nearest one of the target. Directions that no valid beam covers are not seen,
    which is not the same as free. From an off-center scanner, the points are measured from the
    target's center, its coverage is that at an infinite range, and a covered direction into which
    no ray falls has the smaller range of its neighbors.

    Args:
        ranges: ``[*B, M]`` m; M may change from scan to scan.
        scanner: Angles, mount and readings of the scanner.
        target: Beams and mount of the result; its bins are not used.
        scan_motion: ``[*B, 2, 3]`` (x, y, yaw) m and rad of the robot at the times of the scan's
            first and last beam, in its present frame; the result is then that of a scan measured
            now. Frames between them are interpolated linearly. None for a robot at rest.

    Returns:
        The scan of ``target.num_beams`` beams.

    Raises:
        ValueError: If a shape is wrong, or if the beams of the scan exceed a full circle.

    Example:
        >>> front = Scanner(angle_min=-1.57, angle_increment=1.57, max_beam_width=1.57)
        >>> adapt_scan(torch.tensor([2.0, 1.0, math.inf]), front, ScanLayout(4, 1))
        AdaptedScan(ranges=tensor([1., inf, nan, 2.]), states=tensor([2, 1, 0, 2]))
    """
    if ranges.ndim < 1 or ranges.shape[-1] < 1:
        raise ValueError(f"ranges: must have shape [*B, beams], got {tuple(ranges.shape)}")
    if scan_motion is not None and scan_motion.shape != (*ranges.shape[:-1], 2, 3):
        raise ValueError(
            f"scan_motion: must have shape {[*ranges.shape[:-1], 2, 3]}, "
            f"got {list(scan_motion.shape)}"
        )
    ranges = as_real(ranges)
    frame = _frames(ranges, scanner, target, scan_motion)
    rays = _rays(ranges.double(), scanner, frame)
    is_hit = rays.states >= BeamState.RETURN
    is_free = rays.states == BeamState.FREE
    widest = _MAX_WIDENING * _widest(ranges.shape[-1], scanner)
    points = _covered(rays.bearing, rays.width, target, widest)
    width = _width(ranges, scanner, frame).expand_as(rays.width)
    lines = _covered(rays.direction, width, target, widest)
    nearest = _spread(torch.where(is_hit, rays.distance, math.inf), points, target)
    too_near = torch.where(rays.states == BeamState.TOO_NEAR, rays.distance, math.inf)
    too_near = _spread(too_near, points, target) < math.inf
    free = _spread(torch.where(is_free, 0.0, math.inf), lines, target) < math.inf
    seen = _spread(torch.where(is_hit | is_free, 0.0, math.inf), lines, target) < math.inf
    if is_exporting() or bool((seen & ~free & nearest.isinf()).any()):
        nearest = _closed(nearest, free, seen)
    states = torch.where(free, int(BeamState.FREE), int(BeamState.NOT_SEEN))
    states = torch.where(nearest.isfinite(), int(BeamState.RETURN), states)
    states = torch.where(too_near, int(BeamState.TOO_NEAR), states)
    nearest = torch.where(states == BeamState.NOT_SEEN, math.nan, nearest)
    return AdaptedScan(nearest.float(), states)


def _width(ranges: Tensor, scanner: Scanner, frame: Tensor) -> Tensor:
    """Return the angle that a beam stands for, ``[*B, 1]`` or ``[1]`` rad.

    While the robot turns, it is the angle between two beams in the present frame.
    """
    step = abs(scanner.increment(ranges.shape[-1]))
    turn = se2.wrap_angle(frame[..., -1, 2] - frame[..., 0, 2]).abs()
    step = step + turn / max(1, ranges.shape[-1] - 1)
    return step.clamp(max=scanner.max_beam_width).unsqueeze(-1)


def _widest(num_beams: int, scanner: Scanner) -> float:
    """Return the largest angle that a beam can stand for, rad: of a robot that turns at once."""
    step = abs(scanner.increment(num_beams)) + math.pi / max(1, num_beams - 1)
    return min(step, scanner.max_beam_width)


def _frames(
    ranges: Tensor, scanner: Scanner, target: ScanLayout, scan_motion: Tensor | None
) -> Tensor:
    """Return the scanner's pose in the target's frame, ``[*B, M, 3]`` or ``[1, 3]`` float64."""
    mount, center = (
        torch.tensor(list(pose), dtype=torch.float64, device=ranges.device)
        for pose in (scanner.mount, target.mount)
    )
    if scan_motion is not None:
        when = torch.linspace(0.0, 1.0, ranges.shape[-1], dtype=torch.float64, device=mount.device)
        first, last = scan_motion.double().unbind(-2)
        mount = se2.compose(se2.interpolate(first, last, when), mount)
    return se2.relative(center, mount.reshape(-1, 3) if mount.ndim == 1 else mount)


def _rays(ranges: Tensor, scanner: Scanner, frame: Tensor) -> _Rays:
    """Return the beams in the target's frame, without those that hit the robot itself."""
    states = scanner.states(ranges)
    reach = torch.where(states == BeamState.RETURN, ranges, scanner.range_min)
    angle = scanner.bearings(ranges.shape[-1]).to(ranges.device)
    direction = (angle + frame[..., 2]).expand_as(ranges)
    x = frame[..., 0] + reach * direction.cos()
    y = frame[..., 1] + reach * direction.sin()
    distance = torch.hypot(x, y)
    if scanner.own_radius > 0.0:
        mount = torch.tensor(list(scanner.mount), dtype=torch.float64, device=ranges.device)
        turned = angle + mount[2]  # the robot's parts move with it: in its frame at that time
        own = torch.hypot(mount[0] + reach * turned.cos(), mount[1] + reach * turned.sin())
        is_own = (states == BeamState.RETURN) & (own < scanner.own_radius)
        states = torch.where(is_own, int(BeamState.NOT_SEEN), states)
    widening = (reach / distance.clamp(min=1e-9)).clamp(max=_MAX_WIDENING)
    return _Rays(
        states, direction, torch.atan2(y, x), distance, _width(ranges, scanner, frame) * widening
    )


def _covered(bearing: Tensor, width: Tensor, target: ScanLayout, widest: float) -> Tensor:
    """Return the target's beams that each ray covers, ``[*B, M, K]``, ``num_beams`` for none.

    K depends on the widest ray; in an exported graph it is that of the largest possible width.
    """
    step, revolution = target.increment, target.revolution
    middle = (bearing - target.angle_min) / step
    middle = (middle + 0.5).remainder(revolution) - 0.5
    half = 0.5 * width / abs(step) + _ROUNDING
    first, last = (middle - half).ceil(), (middle + half).floor()
    first, last = (torch.where(last < first, middle.round(), side) for side in (first, last))
    if is_exporting():
        count = math.floor(widest / abs(step) + 2.0 * _ROUNDING) + 1
    else:
        count = int((last - first).max()) + 1
    index = first.unsqueeze(-1) + torch.arange(count, device=bearing.device)
    if abs(revolution - target.num_beams) < 0.5:
        inside = index.remainder(target.num_beams)
    else:
        inside = torch.where((index >= 0) & (index < target.num_beams), index, target.num_beams)
    return torch.where(index <= last.unsqueeze(-1), inside, target.num_beams).long()


def _spread(values: Tensor, beams: Tensor, target: ScanLayout) -> Tensor:
    """Return the smallest value ``[*B, N]`` of the rays that cover each beam; inf for none."""
    result = values.new_full((*values.shape[:-1], target.num_beams + 1), math.inf)
    values = values.unsqueeze(-1).expand(beams.shape)
    return result.scatter_reduce(-1, beams.flatten(-2), values.flatten(-2), "amin")[..., :-1]


def _closed(nearest: Tensor, free: Tensor, seen: Tensor) -> Tensor:
    """Close gaps between rays, which an off-center scanner leaves, by the nearer neighbor."""
    is_filled = free | nearest.isfinite()
    beam = torch.arange(nearest.shape[-1], device=nearest.device).expand_as(nearest)
    right, left = nearest_filled(torch.where(is_filled, beam, -1))
    side = torch.minimum(nearest.gather(-1, right), nearest.gather(-1, left))
    return torch.where(seen & ~is_filled, side, nearest)
