"""Distances from points to oriented boxes."""

from __future__ import annotations

import torch
from torch import Tensor


def point_box_distance(points: Tensor, boxes: Tensor) -> Tensor:
    """Return the distance from points to oriented boxes, zero inside.

    Args:
        points: ``[*B, 2]`` m.
        boxes: ``[*B, K, 5]`` (cx, cy, hx, hy, yaw), same frame; a NaN row is an absent box.

    Returns:
        ``[*B, K]`` m; infinite for absent boxes.

    Example:
        >>> point_box_distance(torch.tensor([3.0, 0.0]), torch.tensor([[0.0, 0.0, 1.0, 1.0, 0.0]]))
        tensor([2.])
    """
    offset = points.unsqueeze(-2) - boxes[..., :2]
    cos, sin = torch.cos(boxes[..., 4]), torch.sin(boxes[..., 4])
    along = cos * offset[..., 0] + sin * offset[..., 1]
    across = cos * offset[..., 1] - sin * offset[..., 0]
    outside = torch.stack([along, across], dim=-1).abs() - boxes[..., 2:4]
    distance = outside.clamp_min(0).norm(dim=-1)
    return torch.where(distance.isnan(), torch.inf, distance)
