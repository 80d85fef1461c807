"""Local line fits of a scan: the surface direction at each point."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

HALF_WINDOW = 3  # neighbors on each side
REACH_M = 0.4  # farther neighbors are assumed to lie on another surface
MIN_POINTS = 4  # fewer points do not distinguish a line from noise
MAX_THICKNESS = 0.1  # variance across / variance along the line; a corner or blob exceeds it


class ScanLines(NamedTuple):
    """Result of :func:`fit_lines`."""

    normal: Tensor
    """``[*B, N, 2]`` unit normal of the line, either sign."""
    is_line: Tensor
    """``[*B, N]`` bool, whether the neighborhood of the point is a line."""


def fit_lines(points: Tensor, returns: Tensor) -> ScanLines:
    """Fit a line to each point and its neighbors by total least squares.

    Args:
        points: ``[*B, N, 2]`` m, finite, ordered by bearing over the full circle.
        returns: ``[*B, N]`` bool; points without a return are excluded.

    Returns:
        Lines through the points themselves, along the larger principal axis, whose direction has
        the closed form ``0.5 * atan2(2 s_xy, s_xx - s_yy)``.

    Example:
        >>> wall = torch.stack([torch.ones(9), torch.linspace(-0.4, 0.4, 9)], dim=-1)
        >>> lines = fit_lines(wall, torch.ones(9, dtype=torch.bool))
        >>> lines.is_line[4], lines.normal[4].abs().round(decimals=3)
        (tensor(True), tensor([1., 0.]))
    """
    shifts = range(-HALF_WINDOW, HALF_WINDOW + 1)
    neighbor = torch.stack([points.roll(-k, -2) for k in shifts], dim=-2)  # [*B, N, 2W+1, 2]
    real = torch.stack([returns.roll(-k, -1) for k in shifts], dim=-1)
    reach = torch.linalg.vector_norm(neighbor - points.unsqueeze(-2), dim=-1)
    weight = (real & returns.unsqueeze(-1) & (reach < REACH_M)).to(points.dtype)
    count = weight.sum(-1)
    mean = (weight.unsqueeze(-1) * neighbor).sum(-2) / count.clamp(min=1).unsqueeze(-1)
    x, y = (neighbor - mean.unsqueeze(-2)).unbind(-1)
    s_xx, s_yy = (weight * x * x).sum(-1), (weight * y * y).sum(-1)
    s_xy = (weight * x * y).sum(-1)
    direction = 0.5 * torch.atan2(2.0 * s_xy, s_xx - s_yy)
    spread = torch.hypot(0.5 * (s_xx - s_yy), s_xy)
    along, across = 0.5 * (s_xx + s_yy) + spread, 0.5 * (s_xx + s_yy) - spread
    is_line = (count >= MIN_POINTS) & (across < MAX_THICKNESS * along)
    normal = torch.stack([-direction.sin(), direction.cos()], dim=-1)
    return ScanLines(normal, is_line)
