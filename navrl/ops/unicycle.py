"""Motion of a differential drive over one short interval, exact for constant (v, w).

The scalar functions are plain Python: the compiled kernels are made from them, and a simulator of
one robot calls them as they are. The batched forms do the same for tensors.
"""

import math

import torch
from torch import Tensor

_SMALL_HALF_TURN = 1e-4  # rad; below it sin(h) / h is 1 - h^2 / 6 to the last bit of a double


def advance_pose(
    x: float, y: float, yaw: float, v: float, w: float, duration: float
) -> tuple[float, float, float]:
    """Drive along a circular arc: a chord v t sin(h)/h long in direction yaw + h, where h = w t/2.

    It starts at the pose (x, y, yaw), world, m and rad.

    Args:
        v: forward speed, m/s, constant over the interval.
        w: turn rate, rad/s, constant too.
        duration: s.

    Returns:
        The pose at the end, yaw in (-pi, pi].
    """
    half = 0.5 * w * duration
    sinc = 1.0 - half * half / 6.0 if abs(half) < _SMALL_HALF_TURN else math.sin(half) / half
    chord = v * duration * sinc
    turned = yaw + 2.0 * half
    return (
        x + chord * math.cos(yaw + half),
        y + chord * math.sin(yaw + half),
        turned - 2.0 * math.pi * math.ceil((turned - math.pi) / (2.0 * math.pi)),
    )


def approach_velocity(
    v: float, w: float, v_target: float, w_target: float, wheel_separation: float, limit: float
) -> tuple[float, float]:
    """Return (v, w) after each wheel's rim speed moved towards its target by at most ``limit``.

    With two wheels at +-separation/2 from the centre, v is the mean of their rim speeds and w their
    difference over the separation.
    """
    half = 0.5 * wheel_separation
    left, right = v - half * w, v + half * w
    left += min(max(v_target - half * w_target - left, -limit), limit)
    right += min(max(v_target + half * w_target - right, -limit), limit)
    return 0.5 * (left + right), (right - left) / wheel_separation


def advance_poses(pose: Tensor, velocity: Tensor, duration: float) -> Tensor:
    """:func:`advance_pose` for a batch.

    Args:
        pose: [*B, 3] (x, y, yaw), world.
        velocity: [*B, 2] (v, w).
        duration: s.

    Returns:
        [*B, 3] in the dtype of ``pose``, yaw in (-pi, pi].
    """
    x, y, yaw = pose.unbind(-1)
    v, w = velocity.unbind(-1)
    half = 0.5 * w * duration
    is_small = half.abs() < _SMALL_HALF_TURN
    sinc = torch.where(
        is_small, 1.0 - half * half / 6.0, torch.sin(half) / half.masked_fill(is_small, 1.0)
    )
    chord = v * duration * sinc
    turned = yaw + 2.0 * half
    wrapped = turned - 2.0 * math.pi * torch.ceil((turned - math.pi) / (2.0 * math.pi))
    x_end = x + chord * torch.cos(yaw + half)
    y_end = y + chord * torch.sin(yaw + half)
    return torch.stack((x_end, y_end, wrapped), dim=-1)
