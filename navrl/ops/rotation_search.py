"""A first guess of the rotation between two scans, from their range profiles."""

from __future__ import annotations

import math

import torch
from torch import Tensor

# A beam's vote against a rotation saturates here: it may see a pedestrian or round a corner.
PROFILE_CAP_M = 0.3


def rotation_search(
    source_points: Tensor,
    source_returns: Tensor,
    target_points: Tensor,
    target_returns: Tensor,
    search_range: float = 0.7,
    seen: Tensor | None = None,
) -> Tensor:
    """Turn one range profile over the other and return where they agree best.

    A turn on the spot shifts the ranges of a scan by whole beams and changes nothing else, so the
    rotation is found before any point is matched. Moving 0.2 m changes each range by less than
    the cap and leaves the best shift in place to within a few degrees, which ICP then corrects.

    Args:
        source_points: ``[*B, N, 2]`` m, finite, ordered by bearing and evenly spaced over the
            circle, ``N >= 2``.
        source_returns: ``[*B, N]`` bool.
        target_points: ``[*B, N, 2]`` m, likewise, with as many points.
        target_returns: ``[*B, N]`` bool.
        search_range: Largest rotation considered to either side, rad, at most pi.
        seen: ``[*B, N]`` bool, bearings that the scanner covers; None for all.

    Returns:
        ``[*B]`` rad, the yaw of T_target_source, a multiple of ``2*pi/N``.

    Reference:
        Not in the paper. The cost of a shift is the mean over beams of the absolute difference of
        ranges, capped at ``PROFILE_CAP_M``; a return against no return costs the cap. Where a
        bearing was not seen in one of the two, there is nothing to compare.
    """
    num_beams = source_points.shape[-2]
    max_shift = min(int(search_range / (2.0 * math.pi) * num_beams), num_beams // 2)
    source = torch.where(source_returns, torch.linalg.vector_norm(source_points, dim=-1), math.inf)
    target = torch.where(target_returns, torch.linalg.vector_norm(target_points, dim=-1), math.inf)
    if seen is not None:
        source, target = (torch.where(seen, scan, math.nan) for scan in (source, target))
    shifts = sorted(range(-max_shift, max_shift + 1), key=abs)  # the smaller turn wins a tie
    costs = torch.stack([_cost(source, target.roll(-shift, -1)) for shift in shifts], dim=-1)
    yaw = torch.tensor(shifts, device=source.device) * (2.0 * math.pi / num_beams)
    return yaw.to(source.dtype)[costs.argmin(-1)]


def _cost(source: Tensor, target: Tensor) -> Tensor:
    """Return the mean capped difference of two profiles; a miss is infinite, not seen is NaN."""
    counts = (source.isfinite() | target.isfinite()) & ~(source.isnan() | target.isnan())
    difference = torch.where(counts, (source - target).abs(), 0.0).clamp(max=PROFILE_CAP_M)
    return difference.sum(-1) / counts.sum(-1).clamp(min=1)
