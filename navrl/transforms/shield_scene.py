"""Scene of N worlds in which a shield checks commands, and the times of its checks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from navrl.ops.exporting import cumulative_minimum
from navrl.ops.motion import FAR, room_along
from navrl.transforms.base_motion import Base

DISTANCE_TOLERANCE = 1e-3
"""Distances that differ by less than this are equal, m; far below the noise of a range."""

_MAX_COMMANDS = 10_000  # of the grid, and times at which each is checked: both are in memory
_MAX_TIMES = 100
_CONTACT_CHECKS = 5  # between two checked times, for the time of a contact that cannot be avoided
_TIME_TOLERANCE = 1e-6  # s


@dataclass
class Scene:
    """Points, their motion and required distances, and the robot's motion, of N worlds.

    Args:
        points: ``[N, P, 2]`` m, robot frame.
        motion: ``[N, P, 2]`` m per step.
        required: ``[N, P]`` m, required distance from the robot's center.
        velocity: ``[N, 2]`` (v, w), m/s and rad/s.
        given: ``[N, D, 2]``, commands of the last D steps, latest first.
        base: The base of all worlds.
        times: Times at which commands are checked, s.
        static_until: Time until which points without motion are obstacles, s.
        time_step: Time between two scans, s.
    """

    points: Tensor
    motion: Tensor
    required: Tensor
    velocity: Tensor
    given: Tensor
    base: Base
    times: Sequence[float]
    static_until: float
    time_step: float

    def __getitem__(self, rows: Tensor) -> Scene:
        """Return the selected worlds."""
        names = ("points", "motion", "required", "velocity", "given")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def spare(self, commands: Tensor) -> Tensor:
        """Return the smallest distance beyond the required one over all times, ``[N, S]`` m.

        Args:
            commands: ``[N, S, 2]`` (v, w), m/s and rad/s.
        """
        return self._room(commands, self.times, self.required).amin(-1)

    def free_checks(self, commands: Tensor, radius: float) -> Tensor:
        """Return the number of checks before the first contact, ``[N, S]`` int64.

        Points that are in contact at present are ignored.

        Args:
            commands: ``[N, S, 2]`` (v, w), m/s and rad/s.
            radius: Radius of the robot, m.
        """
        outside = self.points.norm(dim=-1, keepdim=True) > radius
        scene = replace(self, points=torch.where(outside, self.points, FAR))
        step = self.times[0] / _CONTACT_CHECKS
        times = [step * (k + 1) for k in range(_CONTACT_CHECKS * len(self.times))]
        free = scene._room(commands, times, None) > radius
        return cumulative_minimum(free.long()).sum(-1)

    def _room(self, commands: Tensor, times: Sequence[float], required: Tensor | None) -> Tensor:
        """Return the distance to the nearest point at each of T times, ``[N, S, T]`` m."""
        places = self.base.places(commands, self.velocity, self.given, times, self.time_step)
        steps = [time / self.time_step for time in times]
        near = sum(time <= self.static_until + _TIME_TOLERANCE for time in times)
        room = room_along(places[:, :, :near], self.points, self.motion, steps[:near], required)
        if near == len(times):
            return room
        moves = (self.motion != 0.0).any(-1, keepdim=True)
        points = torch.where(moves, self.points, FAR)
        later = room_along(places[:, :, near:], points, self.motion, steps[near:], required)
        return torch.cat([room, later], dim=-1)


def required_distances(
    points: Tensor, motion: Tensor, radius: float, margin: float, moving_margin: float
) -> Tensor:
    """Return the required distance of each point from the robot's center, ``[N, P]`` m.

    Args:
        points: ``[N, P, 2]`` m, robot frame.
        motion: ``[N, P, 2]`` m per step.
        radius: Radius of the robot, m.
        margin: Clearance to points that do not approach the present position, m; to points that
            are nearer already, the present one of the nearest of them.
        moving_margin: Clearance to points that approach the present position, m.
    """
    clear = radius + margin
    approaches = (points * motion).sum(-1) < 0.0
    present = points.norm(dim=-1) - DISTANCE_TOLERANCE
    nearest = torch.where(approaches, FAR, present).amin(-1, keepdim=True)
    nearest = nearest.clamp_min(radius - margin)  # what is deeper is no obstacle
    others = torch.minimum(present, nearest).clamp_max(clear)
    return torch.where(approaches, radius + moving_margin, others)


def checked_times(
    horizon: float, moving_horizon: float, time_step: float, checks_per_step: int
) -> list[float]:
    """Return the times at which commands are checked, s, before anything is allocated for them.

    Args:
        horizon: Time for which a command is simulated, s; divided into equal intervals.
        moving_horizon: The same among moving points, s; rounded up to a multiple of the intervals.
        time_step: Time between two scans, s.
        checks_per_step: Number of checked times in each time step.

    Raises:
        ValueError: If ``moving_horizon`` is less than ``horizon``, or if there are too many times.
    """
    if not horizon <= moving_horizon < math.inf:
        raise ValueError(
            f"moving_horizon={moving_horizon}: must be at least horizon={horizon} (s), and finite"
        )
    count = horizon / time_step * checks_per_step
    if count > _MAX_TIMES:
        raise ValueError(
            f"horizon={horizon}, time_step={time_step}, checks_per_step={checks_per_step}: "
            f"must be at most {_MAX_TIMES} times, horizon / time_step * checks_per_step"
        )
    count = math.ceil(count)
    num_times = moving_horizon / horizon * count
    if num_times > _MAX_TIMES:
        raise ValueError(
            f"moving_horizon={moving_horizon}, horizon={horizon}: must be at most {_MAX_TIMES} "
            f"times, {count} of them until horizon"
        )
    return [horizon * (k + 1) / count for k in range(math.ceil(num_times - _TIME_TOLERANCE))]


def check_grid(num_speeds: int, num_turn_rates: int) -> None:
    """Check the number of commands before anything of that size is allocated.

    Raises:
        ValueError: If there are too many.
    """
    if num_speeds * num_turn_rates > _MAX_COMMANDS:
        raise ValueError(
            f"num_speeds={num_speeds}, num_turn_rates={num_turn_rates}: "
            f"must be at most {_MAX_COMMANDS:,} commands, their product"
        )
