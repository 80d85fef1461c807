"""Motion of a differential drive over one short interval, exact for constant (v, w).

The scalar functions are plain Python: the compiled kernels are made from them, and a simulator of
one robot calls them as they are. The batched forms do the same for tensors.
"""

import math

import torch
from torch import Tensor

_SMALL_HALF_TURN = 1e-4  # rad; below it sin(h) / h is 1 - h^2 / 6 to the last bit of a double


def wrap_angle(angle: float) -> float:
    """Return the angle in (-pi, pi]."""
    return angle - 2.0 * math.pi * math.ceil((angle - math.pi) / (2.0 * math.pi))


def advance_pose(
    x: float, y: float, yaw: float, v: float, w: float, duration: float
) -> tuple[float, float, float]:
    """Drive along a circular arc: the chord has length v t sin(h)/h and direction yaw + h, h = w t/2.

    Args:
        x, y, yaw: pose, world, m and rad.
        v, w: forward speed, m/s, and turn rate, rad/s, both constant over the interval.
        duration: s.

    Returns:
        The pose at the end, yaw in (-pi, pi].
    """
    half = 0.5 * w * duration
    sinc = 1.0 - half * half / 6.0 if abs(half) < _SMALL_HALF_TURN else math.sin(half) / half
    chord = v * duration * sinc
    return (
        x + chord * math.cos(yaw + half),
        y + chord * math.sin(yaw + half),
        wrap_angle(yaw + 2.0 * half),
    )


def approach(current: float, target: float, max_change: float) -> float:
    """Return ``current`` moved towards ``target`` by at most ``max_change`` (which may be inf)."""
    return current + min(max(target - current, -max_change), max_change)


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
