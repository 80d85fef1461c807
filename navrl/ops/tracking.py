"""Motion of groups of moving returns, followed through several past scans."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.checks import check_counts, check_positive
from navrl.ops.backend import as_real
from navrl.ops.grouping import (
    GroupDescriptors,
    group_centers,
    group_centroids,
    squared_distances,
)
from navrl.ops.motion import FAR
from navrl.ops.returns import finite_returns

_MAX_GROUPS = 3600  # ten per degree
_SHIFTS = 3  # iterations of mean shift in each scan


def track_groups(
    points: Tensor,
    moving: Tensor,
    past: Tensor,
    *,
    num_groups: int = 30,
    radius: float = 0.6,
    gate: float = 0.7,
    max_rms: float = 0.5,
    max_range: float = 3.5,
) -> GroupDescriptors:
    """Describe the motion of what moves by following it backwards through the past scans.

    A position is found by mean shift: it moves to the centroid of the moving returns within
    ``radius``, three times. In scan t it starts at a group center as in
    :func:`navrl.ops.grouping.tagd`, in each past scan where the mean motion so far leads from the
    last position. The displacement in one step is the slope of the line fitted to all positions by
    least squares, so it is the mean motion of a pedestrian whose legs stand and swing in turn.
    Above about 1.2 m/s the legs may be farther apart than 0.6 m, and a track may follow one leg.

    Args:
        points: ``[*B, N, 2]`` m, scan t in the robot frame at t.
        moving: ``[*B, N]`` bool, returns that move; the other points are ignored.
        past: ``[*B, K, N, 2]`` m, moving returns of scans t-1 to t-K in the robot frame *at t*;
            those at least :data:`navrl.ops.motion.FAR` away or not finite are ignored.
        num_groups: Number of group centers G.
        radius: Distance of the returns of a group to its position, m; a pedestrian's legs are
            within it.
        gate: Distance up to which the nearest return is the start if none is within ``radius``, m.
            Without any the track ends.
        max_rms: Root mean square distance of the positions to the line above which there is no
            valid motion, m.
        max_range: Range of the group center on a ray without a moving return, m.

    Returns:
        The position at t and, one displacement before, at t-1; equal without valid motion. Valid at
        t if there are moving returns, at t-1 if they were found in at least one past scan and fit.

    Raises:
        ValueError: If a shape or an argument is invalid; the message names it.

    Example:
        >>> now, before = torch.tensor([[1.0, 0.0]]), torch.tensor([[[1.25, 0.0]], [[1.5, 0.0]]])
        >>> track_groups(now, torch.tensor([True]), before, num_groups=4).tagd[0]
        tensor([1.2500, 0.0000, 1.0000, 0.0000])

    Reference:
        Not in the paper. Fukunaga and Hostetler, The Estimation of the Gradient of a Density
        Function, IEEE Trans. Inf. Theory 1975, for mean shift.
    """
    _check_shapes(points, moving, past)
    check_tracking(num_groups, radius, gate, max_rms, max_range)
    points = as_real(points)
    past = as_real(past).to(points.dtype)
    moving = _present(points, moving)
    points = torch.where(moving.unsqueeze(-1), points, 0.0)
    start = group_centers(points, moving, num_groups, max_range)
    now, found = _shifted(points, moving, start, radius)
    places, tracked = [now], [found]
    step = torch.zeros_like(now)
    for k, scan in enumerate(past.unbind(-3)):
        present = _present(scan, torch.ones_like(moving))
        scan = torch.where(present.unsqueeze(-1), scan, 0.0)
        start, near = _started(scan, present, places[-1] - step, radius, gate)
        places.append(_shifted(scan, present, start, radius)[0])
        tracked.append(tracked[-1] & near)
        step = (now - places[-1]) / (k + 1)
    motion, rms = _fitted(torch.stack(places, dim=-3), torch.stack(tracked, dim=-2))
    moved = tracked[1] & (rms <= max_rms)
    before = torch.where(moved.unsqueeze(-1), now - motion, now)
    return GroupDescriptors(torch.cat([before, now], dim=-1), torch.stack([moved, found], dim=-1))


def _present(points: Tensor, returns: Tensor) -> Tensor:
    """Return which of the points ``[*B, N, 2]`` m are finite returns that are not far, bool."""
    return finite_returns(points, returns) & (points.square().sum(-1) < FAR**2)


def _started(
    points: Tensor, present: Tensor, start: Tensor, radius: float, gate: float
) -> tuple[Tensor, Tensor]:
    """Return the start of mean shift and whether a point is near.

    Args:
        points: ``[*B, N, 2]`` m.
        present: ``[*B, N]`` bool; the other points are ignored.
        start: ``[*B, G, 2]`` m, the start if a point is within ``radius`` of it, else it is the
            nearest point within ``gate``.
        radius: Distance in m.
        gate: The same.

    Returns:
        ``[*B, G, 2]`` m, and ``[*B, G]`` bool, whether a point is within ``gate``.
    """
    squared = torch.where(present.unsqueeze(-2), squared_distances(points, start), FAR**2)
    nearest, index = squared.min(dim=-1, keepdim=True)
    point = points.gather(-2, index.expand(*index.shape[:-1], 2))
    snaps = (nearest > radius**2) & (nearest <= gate**2)
    return torch.where(snaps, point, start), (nearest <= gate**2).squeeze(-1)


def _shifted(
    points: Tensor, present: Tensor, start: Tensor, radius: float
) -> tuple[Tensor, Tensor]:
    """Return positions after mean shift, ``[*B, G, 2]`` m, and whether they have points.

    Without any the position remains the start.
    """
    place, has_points = start, present.any(-1, keepdim=True)
    for _ in range(_SHIFTS):
        mean, has_points = group_centroids(points, present, place, radius)
        place = torch.where(has_points.unsqueeze(-1), mean, place)
    return place, has_points


def _fitted(places: Tensor, tracked: Tensor) -> tuple[Tensor, Tensor]:
    """Fit a line to the positions of scans t to t-K that were found.

    Args:
        places: ``[*B, K + 1, G, 2]`` m.
        tracked: ``[*B, K + 1, G]`` bool, the position was found.

    Returns:
        Displacement in one step ``[*B, G, 2]`` m, zero of less than two positions, and the RMS
        distance of the positions to the line ``[*B, G]`` m.
    """
    weight = tracked.to(places.dtype).unsqueeze(-1)
    count = weight.sum(-3, keepdim=True).clamp(min=1.0)
    steps = -torch.arange(places.shape[-3], device=places.device, dtype=places.dtype)
    steps = steps[:, None, None]
    late = weight * (steps - (weight * steps).sum(-3, keepdim=True) / count)
    off = weight * (places - (weight * places).sum(-3, keepdim=True) / count)
    spread = late.square().sum(-3, keepdim=True)  # at least 0.5 of two positions
    motion = (late * off).sum(-3, keepdim=True) / spread.clamp(min=0.5)
    squared = (off - late * motion).square().sum(-1, keepdim=True)
    rms = (squared.sum(-3, keepdim=True) / count).sqrt()
    return motion.squeeze(-3), rms[..., 0, :, 0]


def check_tracking(
    num_groups: int, radius: float, gate: float, max_rms: float, max_range: float
) -> None:
    """Check the options of :func:`track_groups`.

    Raises:
        ValueError: If an option is out of range; the message names it.
    """
    check_counts(num_groups=num_groups)
    if num_groups > _MAX_GROUPS:
        raise ValueError(f"num_groups={num_groups}: must be at most {_MAX_GROUPS}")
    check_positive(radius=radius, gate=gate, max_rms=max_rms, max_range=max_range)
    if gate < radius:
        raise ValueError(f"gate={gate}: must be at least radius={radius} (m)")


def _check_shapes(points: Tensor, moving: Tensor, past: Tensor) -> None:
    if points.ndim < 2 or points.shape[-1] != 2:
        raise ValueError(f"points: must have shape [*B, N, 2], got {tuple(points.shape)}")
    if moving.shape != points.shape[:-1] or moving.dtype != torch.bool:
        raise ValueError(
            f"moving: must be bool of shape {tuple(points.shape[:-1])}, "
            f"got {moving.dtype} of shape {tuple(moving.shape)}"
        )
    same = past.ndim > 2 and (*past.shape[:-3], *past.shape[-2:]) == points.shape
    if not same or past.shape[-3] < 1:
        raise ValueError(
            f"past: must have shape [*B, K, N, 2] with the points' {tuple(points.shape)} and "
            f"K of at least 1, got {tuple(past.shape)}"
        )
