"""Scene of N worlds in which a shield checks commands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torch import Tensor

from navrl.transforms.base_motion import Base


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
