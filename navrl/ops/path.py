"""Arc-length parametrization of a global path: projections, points ahead, length.

A path is a polyline ``[*B, P, 2]`` in m, any frame; repeating its last point (padding) does not
change the results. All functions are batched over ``*B``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navrl.ops.backend import Backend, as_real, is_compiled
from navrl.ops.exporting import cumulative_minimum, search_sorted
from navrl.ops.path_search import LEAVING_RATIO, check_window


class PathProjection(NamedTuple):
    """Result of :func:`project_onto_path`."""

    progress: Tensor
    """``[*B]`` m, arc length from the path's first point to the projection."""
    distance: Tensor
    """``[*B]`` m, distance from the position to the projection."""


def project_onto_path(
    path: Tensor,
    position: Tensor,
    previous_progress: Tensor | None = None,
    ahead: float = 1.0,
    behind: float = 0.0,
    backend: Backend = "auto",
) -> PathProjection:
    """Find the closest point of the path within a window around the previous projection.

    The search window reaches from ``behind`` m before to ``ahead`` m after the previous progress.
    Ahead, the search also ends where the path is :data:`LEAVING_RATIO` times as far from the
    position as the nearest point found so far. The projection therefore stays on its branch where
    the path crosses or approaches itself, and moves on to the next leg only near the bend between
    the two, as for a robot that cuts a corner. With ``behind=0`` progress never decreases.

    Args:
        path: ``[*B, P, 2]`` m, P >= 2. If the path or the position is float64, both are computed in
            float64 to preserve the digits of large coordinates; integers are read as float32.
        position: ``[*B, 2]`` m, same frame.
        previous_progress: ``[*B]`` m, arc length of the previous projection. None searches the
            whole path, as at the start of an episode.
        ahead: Length of the search window after the previous progress, m.
        behind: Length of the search window before the previous progress, m.
        backend: See :mod:`navrl.ops.backend`.

    Returns:
        The arc length of the projection and its distance.

    Raises:
        ValueError: If a shape or a length is invalid; the message names it.

    Example:
        >>> path = torch.tensor([[0.0, 0.0], [4.0, 0.0]])
        >>> project_onto_path(path, torch.tensor([1.0, 0.5]))
        PathProjection(progress=tensor(1.), distance=tensor(0.5000))

    Reference:
        Paper Sec. IV-C, the closest point p^c on the path P; the paper does not define the case
        of a path that crosses itself.
    """
    _check_path(path)
    if position.shape[-1:] != (2,):
        raise ValueError(f"position: must have shape [*B, 2], got {tuple(position.shape)}")
    if position.shape[:-1] != path.shape[:-2]:
        raise ValueError(
            f"position: must have the batch shape of the path {tuple(path.shape[:-2])}, "
            f"got shape {tuple(position.shape)}"
        )
    check_window(ahead, behind)
    dtype = torch.promote_types(as_real(path).dtype, as_real(position).dtype)
    path, position = path.to(dtype), position.to(dtype)
    if previous_progress is not None:
        previous_progress = previous_progress.to(dtype)
    before = () if previous_progress is None else (previous_progress,)
    if is_compiled(backend, path, position, *before):
        return _project_compiled(path, position, previous_progress, ahead, behind)
    arc, length, (step_x, step_y) = _segments(path)
    segment_start = arc[..., :-1]
    inverse_length = length.clamp(min=1e-9).reciprocal()
    offset_x = position[..., 0, None] - path[..., :-1, 0]
    offset_y = position[..., 1, None] - path[..., :-1, 1]
    along = (offset_x * step_x + offset_y * step_y) * inverse_length  # m from the segment's start
    window = None
    if previous_progress is None:
        along = torch.minimum(along.clamp(min=0.0), length)
    else:
        previous = torch.minimum(previous_progress, arc[..., -1]).unsqueeze(-1)
        first, last = previous - behind, previous + ahead
        window = first, last, previous
        along = torch.maximum(along.clamp(min=0.0), first - segment_start)
        along = torch.minimum(torch.minimum(along, last - segment_start), length)
    fraction = along * inverse_length
    miss_x, miss_y = offset_x - fraction * step_x, offset_y - fraction * step_y
    squared = miss_x.square_().addcmul_(miss_y, miss_y)
    if window is not None:
        first, last, previous = window
        squared = squared.masked_fill((arc[..., 1:] < first) | (segment_start > last), math.inf)
        share = torch.minimum(last - segment_start, length) * inverse_length
        end_x, end_y = offset_x - share * step_x, offset_y - share * step_y
        is_ahead = arc[..., 1:] >= previous
        squared = _before_leaving(squared, end_x.square() + end_y.square(), is_ahead)
    squared, index = squared.min(dim=-1, keepdim=True)
    progress = arc.gather(-1, index) + along.gather(-1, index)
    if window is not None:  # rounding must not reduce the progress below the window
        progress = torch.maximum(progress, window[0])
    progress = torch.minimum(progress, arc[..., -1:])  # nor exceed the end of the path
    return PathProjection(progress.squeeze(-1), squared.squeeze(-1).sqrt())


def _before_leaving(squared: Tensor, at_end: Tensor, is_ahead: Tensor) -> Tensor:
    """Mask squared distances to segments after the path has left the position as infinite.

    Args:
        squared: ``[*B, S]`` m^2, to the nearest point of each segment, infinite outside the window.
        at_end: ``[*B, S]`` m^2, to the end of each segment or of its part within the window.
        is_ahead: ``[*B, S]`` bool, whether the segment ends after the previous projection.
    """
    nearest = cumulative_minimum(torch.where(is_ahead, squared, math.inf))
    leaves = is_ahead & (at_end > LEAVING_RATIO**2 * nearest)
    return squared.masked_fill(leaves.cumsum(-1) > leaves.long(), math.inf)


def point_at(path: Tensor, arc: Tensor, backend: Backend = "auto") -> Tensor:
    """Return the point at an arc length along the path.

    Args:
        path: ``[*B, P, 2]`` m, P >= 2.
        arc: ``[*B]`` or ``[*B, K]`` m, arc length from the first point of the path; clamped to the
            ends of the path, so larger values give the goal.
        backend: See :mod:`navrl.ops.backend`.

    Returns:
        ``[*B, 2]`` or ``[*B, K, 2]`` m.

    Raises:
        ValueError: If a shape is invalid; the message names it.

    Example:
        >>> path = torch.tensor([[0.0, 0.0], [4.0, 0.0]])
        >>> point_at(path, torch.tensor([1.5, 9.0])).tolist()
        [[1.5, 0.0], [4.0, 0.0]]
    """
    _check_path(path)
    path = as_real(path)
    arc, batch = arc.to(path.dtype), path.shape[:-2]
    if arc.shape[: len(batch)] != batch or arc.ndim > len(batch) + 1:
        raise ValueError(
            f"arc: must have shape [*B] or [*B, K] for a path {tuple(path.shape)}, "
            f"got {tuple(arc.shape)}"
        )
    if arc.ndim == len(batch):
        return point_at(path, arc.unsqueeze(-1), backend).squeeze(-2)
    if is_compiled(backend, path, arc):
        return _point_at_compiled(path, arc)
    cumulative, length, _ = _segments(path)
    segment = search_sorted(cumulative[..., 1:], arc).clamp(max=length.shape[-1] - 1)
    along = arc - cumulative.gather(-1, segment)
    fraction = (along / length.gather(-1, segment).clamp(min=1e-9)).clamp(0.0, 1.0)
    pair = segment.unsqueeze(-1).expand(*segment.shape, 2)
    return torch.lerp(path.gather(-2, pair), path.gather(-2, pair + 1), fraction.unsqueeze(-1))


def _project_compiled(
    path: Tensor,
    position: Tensor,
    previous_progress: Tensor | None,
    ahead: float,
    behind: float,
) -> PathProjection:
    from navrl.ops.kernels.path import project_rows

    batch, count = path.shape[:-2], path.shape[:-2].numel()
    if previous_progress is None:
        previous_progress = path.new_full(batch, math.nan)
    progress, distance = project_rows(
        path.reshape(count, *path.shape[-2:]),
        position.reshape(count, 2),
        previous_progress.expand(batch).reshape(count),
        float(ahead),
        float(behind),
    )
    return PathProjection(progress.reshape(batch), distance.reshape(batch))


def _point_at_compiled(path: Tensor, arc: Tensor) -> Tensor:
    from navrl.ops.kernels.path import points_at

    batch, count = path.shape[:-2], path.shape[:-2].numel()
    points = points_at(path.reshape(count, *path.shape[-2:]), arc.reshape(count, arc.shape[-1]))
    return points.reshape(*batch, arc.shape[-1], 2)


def path_length(path: Tensor) -> Tensor:
    """Return the length ``[*B]`` in m of paths ``[*B, P, 2]``.

    Raises:
        ValueError: If the shape is invalid.

    Example:
        >>> path_length(torch.tensor([[0.0, 0.0], [3.0, 4.0]]))
        tensor(5.)
    """
    _check_path(path)
    return _segments(as_real(path))[0][..., -1]


def _segments(path: Tensor) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor]]:
    """Return the arc length of each point ``[*B, P]``, and length and (x, y) of each segment."""
    step_x, step_y = path[..., 0].diff(dim=-1), path[..., 1].diff(dim=-1)
    length = step_x.square().addcmul_(step_y, step_y).sqrt_()
    arc = torch.nn.functional.pad(length.cumsum(-1), (1, 0))
    return arc, length, (step_x, step_y)


def _check_path(path: Tensor) -> None:
    if path.ndim < 2 or path.shape[-1] != 2 or path.shape[-2] < 2:
        raise ValueError(f"path: must have shape [*B, P, 2] with P >= 2, got {tuple(path.shape)}")
