"""Outcomes of an episode, shared by training, evaluation and pictures."""

from __future__ import annotations

from enum import IntEnum

import torch
from torch import Tensor

from navrl.sim import Contact


class Outcome(IntEnum):
    """Outcome of a step; all except ``RUNNING`` end the episode.

    - ``SUCCESS``: the robot's center is within the goal radius at the end of a step without
      contact.
    - ``COLLISION_PEDESTRIAN``: any contact with a pedestrian, regardless of the at-fault party
      (``contact`` reports it).
    - ``COLLISION_STATIC``: contact with a wall or furniture.
    - ``TIMEOUT``: the step limit is reached without any of the above.

    Reference:
        Paper Sec. V-A: collision, timeout after 150 steps, goal within 0.2 m.
    """

    RUNNING = 0
    SUCCESS = 1
    COLLISION_PEDESTRIAN = 2
    COLLISION_STATIC = 3
    TIMEOUT = 4


def classify(
    contact: Tensor, goal_distance: Tensor, goal_radius: float, timed_out: Tensor
) -> Tensor:
    """Classify the outcome of a step.

    Args:
        contact: ``[N]`` codes of :class:`navrl.sim.Contact`.
        goal_distance: ``[N]`` m, robot center to goal.
        goal_radius: Distance to the goal that counts as success, m.
        timed_out: ``[N]`` bool, the step limit is reached.

    Returns:
        ``[N]`` int64 codes of :class:`Outcome`; a contact takes precedence over the goal, the goal
        over the step limit.
    """
    outcome = torch.full_like(contact, Outcome.RUNNING, dtype=torch.int64)
    outcome[timed_out] = Outcome.TIMEOUT
    outcome[goal_distance <= goal_radius] = Outcome.SUCCESS
    outcome[(contact == Contact.PEDESTRIAN) | (contact == Contact.HIT_BY_PEDESTRIAN)] = (
        Outcome.COLLISION_PEDESTRIAN
    )
    outcome[contact == Contact.STATIC] = Outcome.COLLISION_STATIC
    return outcome
