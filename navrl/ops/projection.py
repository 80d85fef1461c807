"""Projection of scan points to ranges in another frame."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from navrl.ops.backend import as_real
from navrl.ops.scan_layout import bin_centers


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
    num_bins = points.shape[-2]
    if group_size is None:
        first = math.pi / num_bins
    else:
        first = bin_centers(num_bins * group_size, group_size, points.dtype, points.device)[0]
    bearing = torch.atan2(points[..., 1], points[..., 0]) - first
    distance = torch.linalg.vector_norm(points, dim=-1)
    is_finite = distance.isfinite()
    distance = distance.clamp(max=max_range)
    index = (bearing * (num_bins / (2.0 * math.pi))).round().nan_to_num().long() % num_bins
    empty = torch.full_like(distance, math.inf)
    nearest = empty.scatter_reduce(-1, index, torch.where(is_finite, distance, math.inf), "amin")
    return torch.where(nearest.isfinite(), nearest, fill)
