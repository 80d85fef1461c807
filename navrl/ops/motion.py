"""Command sampling, motion of scan points, and clearance of sampled trajectories."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from navrl.deprecation import renamed_arguments
from navrl.ops.returns import finite_returns

FAR = 100.0
"""Coordinate assigned to points that are not obstacles, m."""


def sample_commands(
    min_speed: float, max_speed: float, max_turn_rate: float, num_speeds: int, num_turn_rates: int
) -> Tensor:
    """Return a grid of commands that includes straight motion and, within the limits, a stop.

    Args:
        min_speed: Smallest forward speed, m/s; if it is not positive, the sample nearest to zero is
            set to zero.
        max_speed: Largest forward speed, m/s.
        max_turn_rate: Largest turn rate to either side, rad/s.
        num_speeds: Number of speeds, at least 2.
        num_turn_rates: Number of turn rates, odd and at least 3.

    Returns:
        ``[num_speeds * num_turn_rates, 2]`` (v, w), m/s and rad/s.

    Raises:
        ValueError: If a number of samples is out of range.

    Example:
        >>> sample_commands(0.0, 0.5, 1.0, num_speeds=2, num_turn_rates=3)[:3].tolist()
        [[0.0, -1.0], [0.0, 0.0], [0.0, 1.0]]
    """
    if num_speeds < 2 or num_turn_rates < 3 or not num_turn_rates % 2:
        raise ValueError(
            f"num_speeds={num_speeds}: must be at least 2; "
            f"num_turn_rates={num_turn_rates}: must be odd and at least 3"
        )
    speeds = torch.linspace(min_speed, max_speed, num_speeds)
    if min_speed <= 0.0 <= max_speed:
        speeds[speeds.abs().argmin()] = 0.0
    turns = torch.linspace(-max_turn_rate, max_turn_rate, num_turn_rates)
    turns[num_turn_rates // 2] = 0.0
    return torch.cartesian_prod(speeds, turns)


@renamed_arguments(least="min_displacement", most="max_displacement")
def point_motion(
    points: Tensor,
    tagd: Tensor,
    valid: Tensor,
    *,
    min_displacement: float,
    max_displacement: float,
    group_radius: float,
) -> Tensor:
    """Return the predicted displacement of each point in one step, from the group descriptors.

    A descriptor (c_{t-1}, c_t) holds the previous and current position of a group. Groups and the
    points around them are assumed to keep their velocity.

    Args:
        points: ``[N, P, 2]`` m, robot frame.
        tagd: ``[N, G, 4]`` m, (c_{t-1}, c_t) in the same frame.
        valid: ``[N, G, 2]`` bool, whether the group at t-1 / t has points.
        min_displacement: Smallest displacement of a moving group, m per step; less is noise of scan
            and alignment.
        max_displacement: Largest displacement of a moving group, m per step; more is a mismatch.
        group_radius: Radius around c_t within which points move with the group, m.

    Returns:
        ``[N, P, 2]`` m per step, zero for static points.

    Example:
        >>> points, moving = torch.tensor([[[1.0, 0.0]]]), torch.tensor([[[1.1, 0.0, 1.0, 0.0]]])
        >>> valid = torch.ones(1, 1, 2, dtype=torch.bool)
        >>> limits = {"min_displacement": 0.05, "max_displacement": 0.5}  # m
        >>> point_motion(points, moving, valid, **limits, group_radius=0.25)
        tensor([[[-0.1000,  0.0000]]])
    """
    before, now = tagd.split(2, dim=-1)
    motion = now - before
    length = motion.norm(dim=-1)
    moved = valid.all(-1) & (length > min_displacement) & (length < max_displacement)
    gap = torch.cdist(points, torch.where(moved.unsqueeze(-1), now, -FAR))
    nearest, group = gap.min(dim=-1, keepdim=True)
    carried = motion.gather(1, group.expand(*group.shape[:-1], 2))
    return torch.where(nearest <= group_radius, carried, 0.0)


def moving_points(
    points: Tensor,
    returns: Tensor,
    tagd: Tensor,
    valid: Tensor,
    *,
    speed_range: tuple[float, float],
    time_step: float,
    group_radius: float,
) -> tuple[Tensor, Tensor]:
    """Return the obstacles of a scan and their predicted displacement in one step.

    Args:
        points: ``[N, P, 2]`` m, robot frame.
        returns: ``[N, P]`` bool, the point is a return.
        tagd: ``[N, G, 4]`` m, descriptors.
        valid: ``[N, G, 2]`` bool, validity of their halves.
        speed_range: Speeds of descriptors that move, m/s; see :func:`check_descriptor_speeds`.
        time_step: Time between two scans, s.
        group_radius: See :func:`point_motion`.

    Returns:
        Points ``[N, P, 2]`` m, :data:`FAR` for those that are no finite return, and their motion
        ``[N, P, 2]`` m per step.

    Example:
        >>> points, nothing = torch.tensor([[[1.0, 0.0]]]), torch.tensor([[False]])
        >>> no_motion = torch.zeros(1, 1, 4), torch.zeros(1, 1, 2, dtype=torch.bool)
        >>> limits = {"speed_range": (0.3, 1.5), "time_step": 0.2, "group_radius": 0.3}
        >>> moving_points(points, nothing, *no_motion, **limits)[0].tolist()
        [[[100.0, 100.0]]]
    """
    returns = finite_returns(points, returns)
    points = torch.where(returns.unsqueeze(-1), points.float(), FAR)
    smallest, largest = (speed * time_step for speed in speed_range)
    motion = point_motion(
        points,
        tagd.float(),
        valid,
        min_displacement=smallest,
        max_displacement=largest,
        group_radius=group_radius,
    )
    return points, motion


def check_descriptor_speeds(least: float, most: float) -> tuple[float, float]:
    """Return the range of speeds of moving descriptors, m/s.

    Raises:
        ValueError: If the range is empty or not positive.
    """
    if not 0.0 < least < most:
        raise ValueError(
            f"min_descriptor_speed={least}, max_descriptor_speed={most}: "
            "must be 0 < min_descriptor_speed < max_descriptor_speed"
        )
    return least, most


def check_commands(margin: float, min_speed: float, max_speed: float) -> None:
    """Check the margin and the speeds of sampled commands.

    Raises:
        ValueError: If the margin is negative, or the range of speeds empty or not finite.
    """
    if not (0.0 <= margin < math.inf and -math.inf < min_speed < max_speed < math.inf):
        raise ValueError(
            f"margin={margin}: must be >= 0; min_speed={min_speed}, max_speed={max_speed}: "
            "must satisfy min_speed < max_speed"
        )


def room_along(
    places: Tensor,
    points: Tensor,
    motion: Tensor,
    steps: Sequence[float],
    required: Tensor | None = None,
) -> Tensor:
    """Return the distance from each trajectory position to the nearest point at the same time.

    Args:
        places: ``[N, S, T, 2]`` m, positions on S trajectories at T times, robot frame at time 0.
        points: ``[N, P, 2]`` m, positions at time 0, :data:`FAR` for points that are not obstacles.
        motion: ``[N, P, 2]`` m per step, displacement of the points.
        steps: The T times, in steps.
        required: ``[N, P]`` m, distance required of each point, subtracted from it; ``None`` for 0.

    Returns:
        ``[N, S, T]`` m.

    Example:
        >>> places, points = torch.zeros(1, 1, 2, 2), torch.tensor([[[1.0, 0.0]]])
        >>> room_along(places, points, torch.tensor([[[-0.5, 0.0]]]), steps=[0.0, 1.0])
        tensor([[[1.0000, 0.5000]]])
    """
    gaps = (torch.cdist(places[:, :, k], points + step * motion) for k, step in enumerate(steps))
    if required is not None:
        gaps = (gap - required.unsqueeze(1) for gap in gaps)
    return torch.stack([gap.amin(-1) for gap in gaps], dim=-1)
