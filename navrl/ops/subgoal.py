"""Subgoals: points near the robot, kept clear of what its scan sees, and the arc that leads there.

A subgoal is polar, in the robot frame: a distance, m, and a bearing, rad, counter-clockwise from
straight ahead.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor


def free_distance(points: Tensor, returns: Tensor, bearing: Tensor, radius: float) -> Tensor:
    """Return how far a disc at the origin can be pushed along a bearing before it touches a return.

    A return straight on the ray stops the disc one radius before it; one beside the ray, within the
    disc's width, a little later. What lies behind never stops it.

    Args:
        points: ``[*B, N, 2]`` m, robot frame.
        returns: ``[*B, N]`` bool, which of the points are real.
        bearing: ``[*B]`` rad.
        radius: of the disc, m.

    Returns:
        ``[*B]`` m, infinite where nothing stops it, never negative.
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
    """Return the command that drives the circular arc to a subgoal.

    Repeated with a subgoal that stays where it is, it stays on that arc and slows down towards its
    end. A subgoal behind the robot, or at its own place, is turned to on the spot.

    Args:
        distance: ``[*B]`` m, not negative.
        bearing: ``[*B]`` rad in [-pi, pi].
        horizon: Time in which the subgoal would be reached, s; longer if a limit forbids it.
        max_speed: m/s.
        max_turn_rate: rad/s.

    Returns:
        ``[*B, 2]`` (v, w), m/s and rad/s, within the limits and still on the arc.
    """
    is_ahead = bearing.abs() <= 0.5 * math.pi
    arc = torch.where(is_ahead, distance / torch.sinc(bearing / math.pi), 0.0)
    speed, turn_rate = arc / horizon, 2.0 * bearing / horizon
    excess = torch.maximum(speed / max_speed, turn_rate.abs() / max_turn_rate).clamp_min(1.0)
    return torch.stack([speed / excess, turn_rate / excess], dim=-1)
