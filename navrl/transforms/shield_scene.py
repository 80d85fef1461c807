"""Scene of N worlds in which a shield checks commands."""

from __future__ import annotations

from dataclasses import dataclass, fields

from torch import Tensor


@dataclass
class Scene:
    """Points, their motion and required distances, and the robot's motion, of N worlds.

    Args:
        points: ``[N, P, 2]`` m, robot frame.
        motion: ``[N, P, 2]`` m per step.
        required: ``[N, P]`` m, required distance from the robot's center.
        velocity: ``[N, 2]`` (v, w), m/s and rad/s.
        given: ``[N, D, 2]``, commands of the last D steps, latest first.
    """

    points: Tensor
    motion: Tensor
    required: Tensor
    velocity: Tensor
    given: Tensor

    def __getitem__(self, rows: Tensor) -> Scene:
        """Return the selected worlds."""
        return Scene(*(getattr(self, field.name)[rows] for field in fields(self)))
