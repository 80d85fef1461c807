"""A scan's points as ranges of another frame."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from navrl.ops.backend import as_real
from navrl.ops.scan_layout import bin_centers


def project_ranges(
    points: Tensor, fill: Tensor, group_size: int | None = 8, max_range: float = 3.5
) -> Tensor:
    """Return the nearest point's range in each bin of bearings.

    Args:
        points: ``[*B, N, 2]`` m, in the frame whose ranges are asked for. Points that stand for no
            return say that their direction was free, and are projected like all others.
        fill: ``[*B, N]`` m, broadcast: the range of a bin that no point falls into. With the scan
            of now, what was not seen before has not moved.
        group_size: Beams in a bin, by which the N bins are those of
            :func:`navrl.ops.pooling.min_pool`; None for bins of any number of beams.
        max_range: Largest range that is returned, m.

    Returns:
        ``[*B, N]`` m. A point that is not finite falls into no bin.

    Raises:
        ValueError: If the shapes are not as above.
    """
    if points.ndim < 2 or points.shape[-1] != 2 or fill.shape[-1:] != points.shape[-2:-1]:
        raise ValueError(
            f"points must have shape [*B, N, 2] and fill [*B, N], "
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
