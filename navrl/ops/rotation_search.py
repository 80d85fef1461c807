"""Initial estimate of the rotation between two scans from their range profiles."""

from __future__ import annotations

import math

import torch
from torch import Tensor

# The cost of a beam saturates here, because beams that hit a pedestrian or pass a corner differ
# between the scans at the correct rotation too.
PROFILE_CAP_M = 0.3


def rotation_search(
    source_points: Tensor,
    source_returns: Tensor,
    target_points: Tensor,
    target_returns: Tensor,
    search_range: float = 0.7,
    seen: Tensor | None = None,
) -> Tensor:
    """Return the rotation at which the range profiles of two scans agree best.

    A rotation in place shifts the ranges of a scan by whole beams, so it can be estimated before
    points are matched. A translation of 0.2 m changes each range by less than the cap and moves the
    best shift by a few degrees at most, which ICP then corrects.

    Args:
        source_points: ``[*B, N, 2]`` m, finite, ordered by bearing and evenly spaced over the full
            circle, ``N >= 2``.
        source_returns: ``[*B, N]`` bool.
        target_points: ``[*B, N, 2]`` m, ordered likewise, with as many points.
        target_returns: ``[*B, N]`` bool.
        search_range: Largest rotation to either side, rad, at most pi.
        seen: ``[*B, N]`` bool, bearings covered by the scanner; None for all.

    Returns:
        ``[*B]`` rad, the yaw of T_target_source, a multiple of ``2*pi/N``.

    Example:
        >>> angle = torch.arange(8) * (math.pi / 4)
        >>> ray, ranges = torch.stack([angle.cos(), angle.sin()], dim=-1), torch.arange(1, 9)
        >>> scan, turned = ray * ranges[:, None], ray * ranges.roll(1)[:, None]
        >>> is_return = torch.ones(8, dtype=torch.bool)
        >>> rotation_search(scan, is_return, turned, is_return, search_range=1.0)  # 2 pi / 8
        tensor(0.7854)

    Reference:
        Not in the paper. The cost of a shift is the mean over beams of the absolute difference of
        ranges, capped at ``PROFILE_CAP_M``; a return against no return costs the cap. Bearings that
        one of the two scans does not cover are excluded.
    """
    num_beams = source_points.shape[-2]
    max_shift = min(int(search_range / (2.0 * math.pi) * num_beams), num_beams // 2)
    source = torch.where(source_returns, torch.linalg.vector_norm(source_points, dim=-1), math.inf)
    target = torch.where(target_returns, torch.linalg.vector_norm(target_points, dim=-1), math.inf)
    if seen is not None:
        source, target = (torch.where(seen, scan, math.nan) for scan in (source, target))
    shifts = sorted(range(-max_shift, max_shift + 1), key=abs)  # a tie selects the smaller rotation
    shift = torch.tensor(shifts, device=source.device)
    turned = (torch.arange(num_beams, device=source.device) + shift.unsqueeze(-1)) % num_beams
    costs = _cost(source.unsqueeze(-2), target[..., turned])
    yaw = shift * (2.0 * math.pi / num_beams)
    return yaw.to(source.dtype)[costs.argmin(-1)]


def _cost(source: Tensor, target: Tensor) -> Tensor:
    """Return the mean capped difference of two profiles; misses are inf, uncovered beams NaN."""
    counts = (source.isfinite() | target.isfinite()) & ~(source.isnan() | target.isnan())
    difference = torch.where(counts, (source - target).abs(), 0.0).clamp(max=PROFILE_CAP_M)
    return difference.sum(-1) / counts.sum(-1).clamp(min=1)
