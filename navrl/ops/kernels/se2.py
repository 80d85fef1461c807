"""Rigid transforms of points in one pass over memory; torch needs six."""

import torch
from torch import Tensor

from navrl.ops.kernels.compiler import kernel
from navrl.ops.kernels.operators import operator


@kernel
def transform_points_kernel(rows, points, cos, sin, translation, moved):
    """Write ``points`` [S, N, 2] rotated by [S] and translated by [S, 2] to ``moved``."""
    for n in range(rows[0], rows[1]):
        turn_x, turn_y, x, y = cos[n], sin[n], translation[n, 0], translation[n, 1]
        for index in range(points.shape[1]):
            old_x, old_y = points[n, index, 0], points[n, index, 1]
            moved[n, index, 0] = turn_x * old_x - turn_y * old_y + x
            moved[n, index, 1] = turn_y * old_x + turn_x * old_y + y


def _moved(points: Tensor, transform: Tensor) -> Tensor:
    return torch.empty_like(points, memory_format=torch.contiguous_format)


@operator(_moved)
def transform_rows(points: Tensor, transform: Tensor) -> Tensor:
    """Return ``points`` [S, N, 2] moved by ``transform`` [S, 3], for :mod:`navrl.ops.se2`."""
    moved, yaw = _moved(points, transform), transform[:, 2]
    transform_points_kernel(points, yaw.cos(), yaw.sin(), transform[:, :2], moved)
    return moved
