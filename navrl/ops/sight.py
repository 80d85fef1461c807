"""Lines of sight between scan points."""

from __future__ import annotations

import torch
from torch import Tensor


def is_hidden(
    target: Tensor, points: Tensor, returns: Tensor, width: float = 0.1, tolerance: float = 0.1
) -> Tensor:
    """Return whether a return lies on the line from the sensor to a target.

    Args:
        target: ``[*B, 2]`` m, in the frame of the points, whose origin is the sensor.
        points: ``[*B, N, 2]`` m; its batch is broadcast with that of the targets.
        returns: ``[*B, N]`` bool; other points are ignored.
        width: A return hides the target if it is nearer to the line than this, m.
        tolerance: Returns this close to the target, or behind it, do not hide it, m.

    Returns:
        ``[*B]`` bool.

    Raises:
        ValueError: If the shapes are invalid.

    Example:
        >>> points, returns = torch.tensor([[1.0, 0.05], [0.5, 2.0]]), torch.tensor([True, True])
        >>> is_hidden(torch.tensor([[2.0, 0.0], [0.9, 0.0]]), points, returns)
        tensor([ True, False])

    Reference:
        Not in the paper.
    """
    if target.shape[-1:] != (2,) or points.shape[-2:] != (*returns.shape[-1:], 2):
        raise ValueError(
            f"target, points, returns: must have shapes [*B, 2], [*B, N, 2] and [*B, N], got "
            f"{tuple(target.shape)}, {tuple(points.shape)} and {tuple(returns.shape)}"
        )
    distance = torch.linalg.vector_norm(target, dim=-1, keepdim=True)
    x, y = (target / distance.clamp(min=1e-9)).unsqueeze(-2).unbind(-1)
    along = points[..., 0] * x + points[..., 1] * y
    aside = points[..., 1] * x - points[..., 0] * y
    is_between = (along > 0.0) & (along < distance - tolerance)
    return (returns & is_between & (aside.abs() < width)).any(-1)
