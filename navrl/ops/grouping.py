"""Temporal accumulation group descriptors (TAGD) of two aligned scans."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from navrl.checks import check_counts, check_positive
from navrl.ops.backend import Backend, as_real, check_same_device, is_compiled
from navrl.ops.beams import SECTOR_TOLERANCE_RAD
from navrl.ops.exporting import kernel_precision
from navrl.ops.returns import finite_returns

EmptyNow = Literal["center", "zeros"]
EmptyPrevious = Literal["current", "center", "zeros"]
EmptyScans = Literal["groups", "zeros"]


class GroupDescriptors(NamedTuple):
    """Result of :func:`tagd`."""

    tagd: Tensor
    """``[*B, N_c, 4]`` m, ``(c_{t-1}, c_t)`` in the robot frame at t."""
    valid: Tensor
    """``[*B, N_c, 2]`` bool, whether the group at t-1 / t has points."""


def tagd(
    points: Tensor,
    returns: Tensor,
    previous_points: Tensor,
    previous_returns: Tensor,
    num_groups: int = 30,
    group_radius: float = 0.25,
    max_range: float = 3.5,
    empty_now: EmptyNow = "center",
    empty_previous: EmptyPrevious = "current",
    empty_scans: EmptyScans = "groups",
    backend: Backend = "auto",
) -> GroupDescriptors:
    """Describe the position of the nearest obstacle in each direction at two times.

    For each of ``num_groups`` rays the nearest return of scan t in the ray's sector sets a group
    center on the ray. The returns of both scans within ``group_radius`` of the center form two
    groups, whose centroids are the descriptor. Their difference is the displacement of the obstacle
    in one step if both groups hold all of its returns. It is less if the obstacle is larger than
    the group, which then holds other parts of it at both times. At the edge of a pedestrian's
    shadow on a wall it is up to the radius although the wall stands still.

    Args:
        points: ``[*B, N, 2]`` m, scan t in the robot frame at t.
        returns: ``[*B, N]`` bool, which points are real returns; the others are ignored.
        previous_points: ``[*B, M, 2]`` m, scan t-1 in the robot frame *at t* (already aligned).
        previous_returns: ``[*B, M]`` bool.
        num_groups: Number of rays N_c.
        group_radius: Distance threshold d_thresh to the group center, m.
        max_range: Range d_max of the group center on a ray without a return, m.
        empty_now: Value of ``c_t`` if the group has no return of scan t: ``"center"`` (the group
            center) or ``"zeros"``.
        empty_previous: Value of ``c_{t-1}`` if the group has no return of scan t-1: ``"current"``
            (equal to ``c_t``, no apparent motion), ``"center"`` or ``"zeros"``.
        empty_scans: Result if neither scan has any return: ``"groups"`` fills each group by the two
            rules above, ``"zeros"`` sets all descriptors to zero.
        backend: See :mod:`navrl.ops.backend`; the kernel computes in float64.

    Returns:
        The descriptors and the validity of their two halves.

    Raises:
        ValueError: If a shape or an argument is invalid; the message names it.

    Example:
        >>> now, before = torch.tensor([[1.0, 0.0]]), torch.tensor([[1.1, 0.0]])
        >>> is_return = torch.tensor([True])
        >>> tagd(now, is_return, before, is_return, num_groups=4).tagd[0]
        tensor([1.1000, 0.0000, 1.0000, 0.0000])

    Reference:
        Paper Sec. IV-A, Algorithm 1. Interpretation: the loop runs over i = 0 .. N_c - 1; the angle
        difference is wrapped, and a point on a border belongs to both sectors; the centroid of an
        empty group, which the paper leaves undefined, is filled as above; with the defaults an
        absent obstacle appears static. ``empty_scans="zeros"`` follows the authors' precursor.
    """
    _check_scan("points", points, "returns", returns)
    _check_scan("previous_points", previous_points, "previous_returns", previous_returns)
    check_grouping(num_groups, group_radius, max_range, empty_now, empty_previous, empty_scans)
    check_same_device(
        points=points,
        returns=returns,
        previous_points=previous_points,
        previous_returns=previous_returns,
    )
    points, previous_points = as_real(points), as_real(previous_points)
    if is_compiled(backend, points, returns, previous_points, previous_returns):
        options = (num_groups, group_radius, max_range, empty_now, empty_previous, empty_scans)
        return _tagd_compiled((points, returns, previous_points, previous_returns), options)
    dtype = points.dtype
    points, previous_points = kernel_precision(points), kernel_precision(previous_points)
    returns = finite_returns(points, returns)
    previous_returns = finite_returns(previous_points, previous_returns)
    points = torch.where(returns.unsqueeze(-1), points, 0.0)
    previous_points = torch.where(previous_returns.unsqueeze(-1), previous_points, 0.0)
    center = group_centers(points, returns, num_groups, max_range)
    now, has_now = group_centroids(points, returns, center, group_radius)
    previous, has_previous = group_centroids(
        previous_points, previous_returns, center, group_radius
    )

    fill_now = center if empty_now == "center" else torch.zeros_like(center)
    now = torch.where(has_now.unsqueeze(-1), now, fill_now)
    fills = {"current": now, "center": center, "zeros": torch.zeros_like(center)}
    previous = torch.where(has_previous.unsqueeze(-1), previous, fills[empty_previous])
    descriptors = torch.cat([previous, now], dim=-1)
    if empty_scans == "zeros":
        has_return = returns.any(-1) | previous_returns.any(-1)
        descriptors = torch.where(has_return[..., None, None], descriptors, 0.0)
    valid = torch.stack([has_previous, has_now], dim=-1)
    return GroupDescriptors(descriptors.to(dtype), valid)


def _tagd_compiled(scans: tuple[Tensor, ...], options: tuple) -> GroupDescriptors:
    from navrl.ops.kernels.grouping import describe_groups

    batch = scans[0].shape[:-2]
    points, returns, previous_points, previous_returns = (
        scan.reshape(batch.numel(), *scan.shape[len(batch) :]) for scan in scans
    )
    results = describe_groups(points, returns, previous_points, previous_returns, *options)
    return GroupDescriptors(*(values.reshape(batch + values.shape[1:]) for values in results))


def group_centers(points: Tensor, returns: Tensor, num_groups: int, max_range: float) -> Tensor:
    """Return the group centers g_i of Algorithm 1.

    Args:
        points: ``[*B, N, 2]`` m, finite, robot frame.
        returns: ``[*B, N]`` bool.
        num_groups: Number of rays N_c; ray i points at ``2*pi*i/N_c``.
        max_range: Distance of the center on a ray whose sector has no return, m.

    Returns:
        ``[*B, N_c, 2]`` m: on each ray, at the distance of the nearest return in its sector.

    Example:
        >>> group_centers(torch.tensor([[1.0, 0.0]]), torch.tensor([True]), 4, max_range=3.5)[0]
        tensor([1., 0.])
    """
    ray = torch.arange(num_groups, device=points.device, dtype=points.dtype)
    ray = ray * (2.0 * math.pi / num_groups)
    bearing = torch.remainder(torch.atan2(points[..., 1], points[..., 0]), 2.0 * math.pi)
    off_ray = (bearing.unsqueeze(-2) - ray.unsqueeze(-1)).abs()  # [0, 2 pi)
    half_sector = math.pi / num_groups + SECTOR_TOLERANCE_RAD
    in_sector = (off_ray <= half_sector) | (off_ray >= 2.0 * math.pi - half_sector)
    distance = torch.where(returns, torch.hypot(points[..., 0], points[..., 1]), max_range)
    nearest = torch.where(in_sector, distance.unsqueeze(-2), max_range).amin(-1)
    nearest = nearest.clamp(max=max_range)
    return nearest.unsqueeze(-1) * torch.stack([ray.cos(), ray.sin()], dim=-1)


def group_centroids(
    points: Tensor, returns: Tensor, center: Tensor, radius: float
) -> tuple[Tensor, Tensor]:
    """Return the centroid of the returns around each center.

    Args:
        points: ``[*B, N, 2]`` m, finite.
        returns: ``[*B, N]`` bool; the other points are ignored.
        center: ``[*B, G, 2]`` m.
        radius: Distance up to which a return belongs to a center, m.

    Returns:
        ``[*B, G, 2]`` m, zero without any, and ``[*B, G]`` bool, whether there are any.

    Example:
        >>> points, center = torch.tensor([[1.0, 0.0], [1.2, 0.0]]), torch.tensor([[1.0, 0.1]])
        >>> group_centroids(points, torch.tensor([True, True]), center, radius=0.5)[0]
        tensor([[1.1000, 0.0000]])
    """
    member = (squared_distances(points, center) <= radius**2) & returns.unsqueeze(-2)
    count = member.sum(-1)
    total = member.to(points.dtype) @ points
    return total / count.clamp(min=1).unsqueeze(-1), count > 0


def squared_distances(points: Tensor, center: Tensor) -> Tensor:
    """Return the squared distance of each center to each point, by differences of coordinates.

    Args:
        points: ``[*B, N, 2]`` m.
        center: ``[*B, G, 2]`` m.

    Returns:
        ``[*B, G, N]`` m^2.

    Example:
        >>> squared_distances(torch.tensor([[3.0, 4.0]]), torch.tensor([[0.0, 0.0]]))
        tensor([[25.]])
    """
    offset_x = points[..., 0].unsqueeze(-2) - center[..., 0].unsqueeze(-1)
    offset_y = points[..., 1].unsqueeze(-2) - center[..., 1].unsqueeze(-1)
    return offset_x.square_().addcmul_(offset_y, offset_y)


def check_grouping(
    num_groups: int,
    group_radius: float,
    max_range: float,
    empty_now: EmptyNow,
    empty_previous: EmptyPrevious,
    empty_scans: EmptyScans,
) -> None:
    """Check the options of :func:`tagd`.

    Raises:
        ValueError: If an option is out of range; the message names it.
    """
    check_counts(num_groups=num_groups)
    check_positive(group_radius=group_radius, max_range=max_range)
    options = {
        "empty_now": (empty_now, ("center", "zeros")),
        "empty_previous": (empty_previous, ("current", "center", "zeros")),
        "empty_scans": (empty_scans, ("groups", "zeros")),
    }
    for name, (value, allowed) in options.items():
        if value not in allowed:
            raise ValueError(f"{name}={value!r}: must be one of {', '.join(allowed)}")


def _check_scan(points_name: str, points: Tensor, returns_name: str, returns: Tensor) -> None:
    if points.ndim < 2 or points.shape[-1] != 2:
        raise ValueError(f"{points_name}: must have shape [*B, N, 2], got {tuple(points.shape)}")
    if returns.shape != points.shape[:-1] or returns.dtype != torch.bool:
        raise ValueError(
            f"{returns_name}: must be bool of shape {tuple(points.shape[:-1])}, "
            f"got {returns.dtype} of shape {tuple(returns.shape)}"
        )
