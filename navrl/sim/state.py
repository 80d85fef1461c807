"""True state of the worlds of a simulator and contact codes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from torch import Tensor

from navrl.deprecation import RenamedMembers
from navrl.ops import contact


class Contact(IntEnum, metaclass=RenamedMembers):
    """Contact codes, which distinguish the at-fault party.

    A contact is classified at the first substep at which the disc of the robot touches a box
    (distance <= 0). A wall has priority over a pedestrian in the same substep. A contact with a
    pedestrian is ``PEDESTRIAN`` (robot at fault) if the robot drives faster than
    :data:`navrl.ops.contact.MOVING_SPEED` and the pedestrian's nearest point lies on the side it
    moves towards, else ``HIT_BY_PEDESTRIAN`` (pedestrian at fault). Among several pedestrians in
    the same substep, ``PEDESTRIAN`` has priority over ``HIT_BY_PEDESTRIAN``.
    """

    NONE = contact.NONE
    STATIC = contact.STATIC  # contact with a wall or a piece of furniture
    PEDESTRIAN = contact.PEDESTRIAN  # the robot moved into a walking or stationary pedestrian
    HIT_BY_PEDESTRIAN = contact.HIT_BY_PEDESTRIAN  # a pedestrian moved into the robot


@dataclass
class SimState:
    """True state of every world after a step, as new tensors.

    Args:
        pose: [N, 3] float32 (x, y, yaw) of the robot, world; yaw in (-pi, pi].
        velocity: [N, C] float32, e.g. (v, w), at the end of the last step, m/s and rad/s.
        contact: [N] int64, codes of :class:`Contact`.
        pedestrians: [N, K, 5] float32 (cx, cy, hx, hy, yaw), world; NaN rows are absent.
        time_s: [N] float32 s since the reset of the world; constant after a contact.
    """

    pose: Tensor
    velocity: Tensor
    contact: Tensor
    pedestrians: Tensor
    time_s: Tensor
