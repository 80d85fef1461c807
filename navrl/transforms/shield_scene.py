"""Scene of N worlds in which a shield checks commands, and the size of its grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from torch import Tensor

from navrl.transforms.base_motion import Base

_MAX_COMMANDS = 10_000  # of the grid, and times at which each is checked: both are in memory
_MAX_TIMES = 100


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
    """

    points: Tensor
    motion: Tensor
    required: Tensor
    velocity: Tensor
    given: Tensor
    base: Base
    times: Sequence[float]

    def __getitem__(self, rows: Tensor) -> Scene:
        """Return the selected worlds."""
        names = ("points", "motion", "required", "velocity", "given")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def check_sizes(
    horizon: float, time_step: float, checks_per_step: int, num_speeds: int, num_turn_rates: int
) -> int:
    """Return the number of checked times, before anything of that size is allocated.

    Raises:
        ValueError: If there are too many times or commands.
    """
    count = horizon / time_step * checks_per_step
    if count > _MAX_TIMES:
        raise ValueError(
            f"horizon={horizon}, time_step={time_step}, checks_per_step={checks_per_step}: "
            f"must be at most {_MAX_TIMES} times, horizon / time_step * checks_per_step"
        )
    if num_speeds * num_turn_rates > _MAX_COMMANDS:
        raise ValueError(
            f"num_speeds={num_speeds}, num_turn_rates={num_turn_rates}: "
            f"must be at most {_MAX_COMMANDS:,} commands, their product"
        )
    return math.ceil(count)
