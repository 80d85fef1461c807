"""What a simulator reports: the true state of every world, and what robots touch."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from torch import Tensor

from navrl.ops import contact


class Contact(IntEnum):
    """What the robot touches, told apart because a robot is not to blame for every contact.

    Decided at the first substep at which the robot's disc reaches a box (distance <= 0). A wall
    wins over a pedestrian touched in the same substep. A pedestrian contact is ``RUN_INTO`` unless
    the robot drives faster than :data:`navrl.ops.contact.MOVING_SPEED` and the pedestrian's nearest
    point lies on the side that it drives towards: then it is ``PEDESTRIAN``. Among several
    pedestrians touched in the same substep, ``PEDESTRIAN`` wins over ``RUN_INTO``.
    """

    NONE = contact.NONE
    STATIC = contact.STATIC  # the robot touched a wall or a piece of furniture
    PEDESTRIAN = contact.PEDESTRIAN  # the robot moved into a pedestrian, walking or standing
    RUN_INTO = contact.RUN_INTO  # a pedestrian moved into the robot


@dataclass
class SimState:
    """The true state of every world after a step: fresh tensors, never views of the simulator.

    Args:
        pose: [N, 3] float32 (x, y, yaw) of the robot, world; yaw in (-pi, pi].
        velocity: [N, 2] float32 (v, w) driven at the end of the last step, m/s and rad/s.
        contact: [N] int64 codes of :class:`Contact`.
        pedestrians: [N, K, 5] float32 (cx, cy, hx, hy, yaw), world; NaN rows where absent.
        time_s: [N] float32, time since the world's reset; stands still after a contact.
    """

    pose: Tensor
    velocity: Tensor
    contact: Tensor
    pedestrians: Tensor
    time_s: Tensor
