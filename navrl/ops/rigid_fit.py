"""Weighted least-squares rigid motion between matched points."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.ops import se2


def fit_rigid(source: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Return the transform that maps ``source`` onto ``target`` with least squared error.

    In the plane the solution has a closed form: with the centered cross-covariance H of source and
    target the optimal rotation is ``atan2(H_xy - H_yx, H_xx + H_yy)``. It equals the rotation
    ``V diag(1, det) U^T`` of the singular value decomposition (Arun et al. 1987), reflections
    excluded.

    Args:
        source: ``[*B, N, 2]`` m.
        target: ``[*B, N, 2]`` m, matched with ``source`` by index.
        weight: ``[*B, N]``, not negative; all-zero weights give the identity.

    Returns:
        ``[*B, 3]`` (m, m, rad) T_target_source.

    Example:
        >>> source = torch.tensor([[0.0, 0.0], [1.0, 0.0]])
        >>> fit_rigid(source, source + torch.tensor([0.0, 2.0]), torch.ones(2))
        tensor([0., 2., 0.])
    """
    weight = weight / weight.sum(-1, keepdim=True).clamp(min=1e-12)
    source_mean = torch.stack([(weight * source[..., i]).sum(-1) for i in (0, 1)], dim=-1)
    target_mean = torch.stack([(weight * target[..., i]).sum(-1) for i in (0, 1)], dim=-1)
    source_x, source_y = (source - source_mean.unsqueeze(-2)).unbind(-1)
    target_x, target_y = (target - target_mean.unsqueeze(-2)).unbind(-1)
    sin = (weight * (source_x * target_y - source_y * target_x)).sum(-1)
    cos = (weight * (source_x * target_x + source_y * target_y)).sum(-1)
    yaw = torch.atan2(sin, cos)
    translation = target_mean - se2.rotate(source_mean, yaw)
    return torch.cat([translation, yaw.unsqueeze(-1)], dim=-1)
