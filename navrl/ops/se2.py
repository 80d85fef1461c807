"""Rigid transforms in the plane as ``[..., 3]`` tensors ``(x, y, yaw)``.

A transform ``T_target_source`` maps points of the source frame into the target frame; the pose of a
robot in the world is ``T_world_robot``. Transforms chain by their inner names:
``compose(T_a_b, T_b_c)`` is ``T_a_c``. Leading dimensions broadcast.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from navrl.ops.backend import as_real, is_compiled
from navrl.ops.exporting import is_exporting


def wrap_angle(angle: Tensor) -> Tensor:
    """Wrap ``angle`` [rad] to (-pi, pi].

    Example:
        >>> wrap_angle(torch.tensor([4.0, -4.0]))
        tensor([-2.2832,  2.2832])
    """
    return math.pi - torch.remainder(math.pi - angle, 2.0 * math.pi)


def rotate(vectors: Tensor, yaw: Tensor) -> Tensor:
    """Rotate ``vectors`` counter-clockwise.

    Args:
        vectors: ``[..., 2]``.
        yaw: ``[...]`` rad, broadcast against the leading dimensions of ``vectors``.

    Returns:
        ``[..., 2]`` rotated vectors.

    Example:
        >>> rotate(torch.tensor([1.0, 0.0]), torch.tensor(math.pi / 2)).round(decimals=3).abs()
        tensor([0., 1.])
    """
    cos, sin = yaw.cos(), yaw.sin()
    x, y = vectors.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)


def transform_points(T_target_source: Tensor, points_source: Tensor) -> Tensor:
    """Map points of the source frame into the target frame.

    Args:
        T_target_source: ``[*B, 3]`` (m, m, rad).
        points_source: ``[*B, N, 2]`` m.

    Returns:
        ``[*B, N, 2]`` m, in the target frame.

    Example:
        >>> quarter_turn = torch.tensor([1.0, 0.0, math.pi / 2])
        >>> transform_points(quarter_turn, torch.tensor([[1.0, 0.0]])).round(decimals=3)
        tensor([[1., 1.]])
    """
    T_target_source, points_source = as_real(T_target_source), as_real(points_source)
    is_row_by_row = T_target_source.shape == (*points_source.shape[:-2], 3)
    has_kernel = T_target_source.dtype == points_source.dtype and not points_source.is_cuda
    if is_row_by_row and has_kernel and is_compiled("auto", T_target_source, points_source):
        return _transform_compiled(T_target_source, points_source)
    if is_exporting():
        rows = rotation_rows(T_target_source[..., 2:])
        return points_source @ rows + T_target_source[..., None, :2]
    return rotate(points_source, T_target_source[..., 2:]) + T_target_source[..., None, :2]


def rotation_rows(yaw: Tensor) -> Tensor:
    """Return the matrix by which rows (x, y) are multiplied to rotate them counter-clockwise.

    In an exported graph a product takes fewer operations than :func:`rotate`.

    Args:
        yaw: ``[*B, 1]`` rad.

    Returns:
        ``[*B, 2, 2]``.

    Example:
        >>> torch.tensor([[1.0, 0.0]]) @ rotation_rows(torch.tensor([0.0]))
        tensor([[1., 0.]])
    """
    cos, sin = yaw.cos(), yaw.sin()
    return torch.cat([cos, sin, -sin, cos], dim=-1).unflatten(-1, (2, 2))


def _transform_compiled(T_target_source: Tensor, points_source: Tensor) -> Tensor:
    from navrl.ops.kernels.se2 import transform_rows

    points = points_source.reshape(-1, *points_source.shape[-2:])
    return transform_rows(points, T_target_source.reshape(-1, 3)).view(points_source.shape)


def compose(T_a_b: Tensor, T_b_c: Tensor) -> Tensor:
    """Compose two transforms to ``T_a_c`` ``[..., 3]`` with yaw in (-pi, pi].

    Example:
        >>> compose(torch.tensor([1.0, 0.0, 0.0]), torch.tensor([2.0, 0.0, 0.5]))
        tensor([3.0000, 0.0000, 0.5000])
    """
    if is_exporting() and T_a_b.ndim == T_b_c.ndim and T_a_b.shape == T_b_c.shape:
        moved = T_b_c[..., None, :2] @ rotation_rows(T_a_b[..., 2:])
        translation = moved.squeeze(-2) + T_a_b[..., :2]
    else:
        translation = rotate(T_b_c[..., :2], T_a_b[..., 2]) + T_a_b[..., :2]
    yaw = wrap_angle(T_a_b[..., 2] + T_b_c[..., 2])
    return torch.cat([translation, yaw.unsqueeze(-1)], dim=-1)


def inverse(T_a_b: Tensor) -> Tensor:
    """Return ``T_b_a`` ``[..., 3]``, the inverse of ``T_a_b``.

    Example:
        >>> inverse(torch.tensor([1.0, 2.0, 0.0]))
        tensor([-1., -2.,  0.])
    """
    translation = -rotate(T_a_b[..., :2], -T_a_b[..., 2])
    yaw = wrap_angle(-T_a_b[..., 2])
    return torch.cat([translation, yaw.unsqueeze(-1)], dim=-1)


def relative(T_world_target: Tensor, T_world_source: Tensor) -> Tensor:
    """Return ``T_target_source`` ``[..., 3]`` from two poses in the same world.

    Example:
        >>> relative(torch.tensor([1.0, 0.0, 0.0]), torch.tensor([3.0, 1.0, 0.5]))
        tensor([2.0000, 1.0000, 0.5000])
    """
    return compose(inverse(T_world_target), T_world_source)


def interpolate(T_a_b: Tensor, T_a_c: Tensor, fraction: Tensor) -> Tensor:
    """Interpolate linearly between two frames, along the shorter turn.

    Args:
        T_a_b: ``[*B, 3]`` (m, m, rad), frame at fraction 0.
        T_a_c: ``[*B, 3]``, frame at fraction 1.
        fraction: ``[N]``.

    Returns:
        ``[*B, N, 3]``; the yaw is not wrapped.

    Example:
        >>> interpolate(torch.zeros(3), torch.tensor([1.0, 0.0, 0.2]), torch.tensor([0.5]))
        tensor([[0.5000, 0.0000, 0.1000]])
    """
    turned = wrap_angle(T_a_c[..., 2:] - T_a_b[..., 2:])
    step = torch.cat([T_a_c[..., :2] - T_a_b[..., :2], turned], dim=-1)
    return T_a_b.unsqueeze(-2) + fraction.unsqueeze(-1) * step.unsqueeze(-2)
