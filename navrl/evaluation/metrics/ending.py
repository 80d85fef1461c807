"""Outcome metrics, including the at-fault party; 1 where the condition holds, else 0."""

from __future__ import annotations

import numpy as np
import torch

from navrl.deprecation import renamed_attributes
from navrl.envs import Outcome
from navrl.evaluation.metrics.trajectory import Trajectory
from navrl.ops.distance import point_box_distance
from navrl.sim import Contact


def success(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` whether the goal was reached in time without contact.

    Example:
        >>> success(Trajectory.of_positions([(0, 0), (1, 0)], outcome=Outcome.SUCCESS))
        array([1.])

    Reference:
        Paper Sec. V-A, goal within 0.2 m; SR of Francis et al. 2023 (arXiv 2306.16740).
    """
    return (trajectory.outcome == Outcome.SUCCESS).astype(float)


def timeout(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` whether the time limit was reached before goal and contact.

    Example:
        >>> timeout(Trajectory.of_positions([(0, 0), (1, 0)], outcome=Outcome.TIMEOUT))
        array([1.])

    Reference:
        Paper Sec. V-A, 150 steps of 0.2 s; TO of Francis et al. 2023.
    """
    return (trajectory.outcome == Outcome.TIMEOUT).astype(float)


def collision(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` whether there was any contact.

    Example:
        >>> collision(Trajectory.of_positions([(0, 0), (1, 0)], contact=Contact.STATIC))
        array([1.])

    Reference:
        Paper Sec. V-A; C of Francis et al. 2023.
    """
    return (trajectory.contact != Contact.NONE).astype(float)


def moved_into_pedestrian(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` whether the robot hit a pedestrian: above 0.05 m/s and towards them.

    Example:
        >>> hit = Trajectory.of_positions([(0, 0), (1, 0)], contact=Contact.PEDESTRIAN)
        >>> moved_into_pedestrian(hit), hit_by_pedestrian(hit)
        (array([1.]), array([0.]))

    Reference:
        The human collisions (HC) of Francis et al. 2023 with the robot at fault; the rule is ours,
        :class:`navrl.sim.Contact`.
    """
    return (trajectory.contact == Contact.PEDESTRIAN).astype(float)


def hit_by_pedestrian(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` whether a pedestrian moved into the robot.

    Example:
        >>> hit = Trajectory.of_positions([(0, 0), (1, 0)], contact=Contact.HIT_BY_PEDESTRIAN)
        >>> moved_into_pedestrian(hit), hit_by_pedestrian(hit)
        (array([0.]), array([1.]))

    Reference:
        The other part of HC of Francis et al. 2023; counted as collisions too, as in the paper.
    """
    return (trajectory.contact == Contact.HIT_BY_PEDESTRIAN).astype(float)


__getattr__ = renamed_attributes(__name__, {"run_into": "hit_by_pedestrian"})


def collision_wall(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` whether the robot touched a wall.

    Example:
        >>> boxes = [(1.3, 0, 0.1, 2, 0), (0, 1, 0.2, 0.2, 0)]  # wall ahead, furniture left
        >>> hit = Trajectory.of_positions(
        ...     [(0, 0), (1, 0)], boxes=boxes, num_furniture=1, contact=Contact.STATIC
        ... )
        >>> collision_wall(hit), collision_furniture(hit)
        (array([1.]), array([0.]))

    Reference:
        WC of Francis et al. 2023.
    """
    return _static(trajectory, furniture=False)


def collision_furniture(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` whether the robot touched a piece of furniture.

    Example:
        >>> boxes = [(0, 2, 2, 0.1, 0), (1.3, 0, 0.1, 0.1, 0)]  # a wall, furniture ahead
        >>> hit = Trajectory.of_positions(
        ...     [(0, 0), (1, 0)], boxes=boxes, num_furniture=1, contact=Contact.STATIC
        ... )
        >>> collision_wall(hit), collision_furniture(hit)
        (array([0.]), array([1.]))

    Reference:
        OC, collisions with objects, of Francis et al. 2023.
    """
    return _static(trajectory, furniture=True)


def _static(trajectory: Trajectory, furniture: bool) -> np.ndarray:
    """Return ``[E]`` whether the touched box, the one nearest to the robot, is furniture."""
    touched = trajectory.contact == Contact.STATIC
    if trajectory.boxes.shape[1] == 0:
        return touched.astype(float) * (not furniture)
    end = trajectory.pose[np.arange(len(trajectory)), trajectory.num_steps, :2]
    distance = point_box_distance(torch.from_numpy(end), torch.from_numpy(trajectory.boxes))
    nearest = distance.argmin(dim=-1, keepdim=True).numpy()
    is_furniture = np.take_along_axis(trajectory.is_furniture, nearest, axis=1)[:, 0]
    return (touched & (is_furniture == furniture)).astype(float)
