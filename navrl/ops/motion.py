"""Sampled commands, the motion of points seen by the lidar, and the clearance between them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

FAR = 100.0
"""m, where points go that are no obstacle."""


def sample_commands(
    min_speed: float, max_speed: float, max_turn_rate: float, num_speeds: int, num_turn_rates: int
) -> Tensor:
    """Return a grid of commands that includes straight on and, if the limits allow it, a stop.

    Args:
        min_speed: m/s; the speed nearest to zero becomes zero if it is not positive.
        max_speed: m/s.
        max_turn_rate: rad/s, to either side.
        num_speeds: At least 2.
        num_turn_rates: Odd and at least 3.

    Returns:
        ``[num_speeds * num_turn_rates, 2]`` (v, w), m/s and rad/s.

    Raises:
        ValueError: If a number of samples is not as above.
    """
    if num_speeds < 2 or num_turn_rates < 3 or not num_turn_rates % 2:
        raise ValueError(
            f"num_speeds={num_speeds}: need at least 2; "
            f"num_turn_rates={num_turn_rates}: need an odd number of at least 3"
        )
    speeds = torch.linspace(min_speed, max_speed, num_speeds)
    if min_speed <= 0.0 <= max_speed:
        speeds[speeds.abs().argmin()] = 0.0
    turns = torch.linspace(-max_turn_rate, max_turn_rate, num_turn_rates)
    turns[num_turn_rates // 2] = 0.0
    return torch.cartesian_prod(speeds, turns)


def point_motion(
    points: Tensor,
    tagd: Tensor,
    valid: Tensor,
    *,
    least: float,
    most: float,
    group_radius: float,
) -> Tensor:
    """Return how far each point moves in a step, if it belongs to a descriptor that moved.

    A descriptor (c_{t-1}, c_t) is where a group was and is: it is taken to walk on like that, and
    so are the points around it.

    Args:
        points: ``[N, P, 2]`` m, robot frame.
        tagd: ``[N, G, 4]`` m, (c_{t-1}, c_t) in the same frame.
        valid: ``[N, G, 2]`` bool, which halves are real.
        least: m a step; slower is noise of scan and alignment.
        most: m a step; faster is a mismatch.
        group_radius: m around c_t within which points move with it.

    Returns:
        ``[N, P, 2]`` m a step, zero for what stands.
    """
    before, now = tagd.split(2, dim=-1)
    motion = now - before
    length = motion.norm(dim=-1)
    moved = valid.all(-1) & (length > least) & (length < most)
    gap = torch.cdist(points, torch.where(moved.unsqueeze(-1), now, -FAR))
    nearest, group = gap.min(dim=-1, keepdim=True)
    carried = motion.gather(1, group.expand(*group.shape[:-1], 2))
    return torch.where(nearest <= group_radius, carried, 0.0)


def room_along(places: Tensor, points: Tensor, motion: Tensor, steps: Sequence[float]) -> Tensor:
    """Return the distance from each place on an arc to the nearest point at that time.

    Args:
        places: ``[N, S, T, 2]`` m, on S arcs at T times, robot frame of time 0.
        points: ``[N, P, 2]`` m at time 0; what is no obstacle lies :data:`FAR` away.
        motion: ``[N, P, 2]`` m a step.
        steps: T times, in steps.

    Returns:
        ``[N, S, T]`` m.
    """
    gaps = [
        torch.cdist(places[:, :, k], points + step * motion).amin(-1)
        for k, step in enumerate(steps)
    ]
    return torch.stack(gaps, dim=-1)
