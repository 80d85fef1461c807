"""Exact motion of a differential drive with constant (v, w) over one short interval.

The scalar functions are plain Python: the kernels are compiled from them, and the single-robot
simulator calls them directly. The batched forms compute the same for tensors.
"""

import math

import torch
from torch import Tensor

_SMALL_ANGLE = 1e-4  # rad; below it sin(h) / h equals 1 - h^2 / 6 in double precision


def advance_pose(
    x: float, y: float, yaw: float, v: float, w: float, duration: float
) -> tuple[float, float, float]:
    """Integrate the unicycle model from the pose (x, y, yaw) along a circular arc.

    The chord has length ``v t sin(h) / h`` and direction ``yaw + h`` with ``h = w t / 2``. The pose
    is in the world frame, m and rad.

    Args:
        v: Forward speed, m/s, constant over the interval.
        w: Turn rate, rad/s, constant over the interval.
        duration: Length of the interval, s.

    Returns:
        The pose at the end, yaw in (-pi, pi].

    Example:
        >>> advance_pose(0.0, 0.0, 0.0, v=0.5, w=0.0, duration=2.0)
        (1.0, 0.0, 0.0)
    """
    half = 0.5 * w * duration
    sinc = 1.0 - half * half / 6.0 if abs(half) < _SMALL_ANGLE else math.sin(half) / half
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
    """Return (v, w) after each wheel's rim speed approached its target by at most ``limit``.

    With two wheels at +-separation/2 from the center, v is the mean of their rim speeds and w their
    difference divided by the separation.

    Args:
        v: Forward speed, m/s.
        w: Turn rate, rad/s.
        v_target: Commanded forward speed, m/s.
        w_target: Commanded turn rate, rad/s.
        wheel_separation: Distance between the wheels, m.
        limit: Largest change of a rim speed, m/s.

    Example:
        >>> approach_velocity(0.0, 0.0, 1.0, 0.0, wheel_separation=0.25, limit=0.5)
        (0.5, 0.0)
    """
    half = 0.5 * wheel_separation
    left, right = v - half * w, v + half * w
    left += min(max(v_target - half * w_target - left, -limit), limit)
    right += min(max(v_target + half * w_target - right, -limit), limit)
    return 0.5 * (left + right), (right - left) / wheel_separation


def advance_poses(pose: Tensor, velocity: Tensor, duration: float) -> Tensor:
    """Integrate the unicycle model for a batch of poses; see :func:`advance_pose`.

    Args:
        pose: [*B, 3] (x, y, yaw), world, m and rad.
        velocity: [*B, 2] (v, w), m/s and rad/s.
        duration: Length of the interval, s.

    Returns:
        [*B, 3] in the dtype of ``pose``, yaw in (-pi, pi].

    Example:
        >>> advance_poses(torch.zeros(3), torch.tensor([0.5, 0.0]), duration=2.0)
        tensor([1., 0., 0.])
    """
    x, y, yaw = pose.unbind(-1)
    v, w = velocity.unbind(-1)
    half = 0.5 * w * duration
    is_small = half.abs() < _SMALL_ANGLE
    sinc = torch.where(
        is_small, 1.0 - half * half / 6.0, torch.sin(half) / half.masked_fill(is_small, 1.0)
    )
    chord = v * duration * sinc
    turned = yaw + 2.0 * half
    wrapped = turned - 2.0 * math.pi * torch.ceil((turned - math.pi) / (2.0 * math.pi))
    x_end = x + chord * torch.cos(yaw + half)
    y_end = y + chord * torch.sin(yaw + half)
    return torch.stack((x_end, y_end, wrapped), dim=-1)
