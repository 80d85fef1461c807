"""Polar subgoals near the robot: free distance along a bearing and the arc to a subgoal.

A subgoal is given in polar coordinates of the robot frame: a distance, m, and a bearing, rad,
counter-clockwise from straight ahead.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def free_distance(points: Tensor, returns: Tensor, bearing: Tensor, radius: float) -> Tensor:
    """Return how far a disc at the origin can translate along a bearing without contact.

    A return on the ray limits the distance to its range minus the radius; a return beside the ray
    within the width of the disc limits it less. Returns behind the disc are ignored.

    Args:
        points: ``[*B, N, 2]`` m, robot frame.
        returns: ``[*B, N]`` bool, which points are real returns.
        bearing: ``[*B]`` rad.
        radius: Radius of the disc, m.

    Returns:
        ``[*B]`` m, not negative, infinite without an obstacle.

    Example:
        >>> free_distance(
        ...     torch.tensor([[2.0, 0.0]]), torch.tensor([True]), torch.tensor(0.0), radius=0.25
        ... )
        tensor(1.7500)
    """
    direction = torch.stack([bearing.cos(), bearing.sin()], dim=-1).unsqueeze(-2)
    along = (points * direction).sum(-1)
    beside = points[..., 1] * direction[..., 0] - points[..., 0] * direction[..., 1]
    reach = (radius * radius - beside.square()).clamp_min(0.0).sqrt()
    is_ahead = returns & (along > 0.0) & (beside.abs() < radius)
    return torch.where(is_ahead, along - reach, math.inf).amin(-1).clamp_min(0.0)


def steer_to(
    distance: Tensor, bearing: Tensor, horizon: float, max_speed: float, max_turn_rate: float
) -> Tensor:
    """Return the command that follows the circular arc to a subgoal.

    Applied repeatedly with a fixed subgoal, the commands stay on that arc and slow down towards its
    end. For a subgoal behind the robot or at its position the robot rotates in place.

    Args:
        distance: ``[*B]`` m, not negative.
        bearing: ``[*B]`` rad in [-pi, pi].
        horizon: Time in which the subgoal would be reached, s; longer if limited.
        max_speed: Largest forward speed, m/s.
        max_turn_rate: Largest turn rate, rad/s.

    Returns:
        ``[*B, 2]`` (v, w), m/s and rad/s, scaled to the limits with the curvature of the arc.

    Example:
        >>> ahead = torch.tensor(1.0), torch.tensor(0.0)
        >>> steer_to(*ahead, horizon=2.0, max_speed=0.7, max_turn_rate=1.5)
        tensor([0.5000, 0.0000])
    """
    is_ahead = bearing.abs() <= 0.5 * math.pi
    arc = torch.where(is_ahead, distance / torch.sinc(bearing / math.pi), 0.0)
    speed, turn_rate = arc / horizon, 2.0 * bearing / horizon
    excess = torch.maximum(speed / max_speed, turn_rate.abs() / max_turn_rate).clamp_min(1.0)
    return torch.stack([speed / excess, turn_rate / excess], dim=-1)
