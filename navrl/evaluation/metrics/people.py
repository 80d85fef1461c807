"""Metrics of the distance to pedestrians, between surfaces of hull and cuboid."""

from __future__ import annotations

import numpy as np

from navrl.evaluation.metrics.trajectory import Trajectory, mean
from navrl.sim import Contact

INTIMATE_M = 0.45
"""Limit of the intimate distance, m (Hall, "The Hidden Dimension", 1966)."""
PERSONAL_M = 1.2
"""Limit of the personal distance, m (Hall 1966)."""


def min_pedestrian_distance(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m, the minimum distance to a pedestrian; infinite without pedestrians.

    Example:
        >>> drive = [(0, 0), (1, 0)]  # a robot of radius 0.2 m, a pedestrian 0.2 m wide at x = 3
        >>> met = Trajectory.of_positions(drive, people=[(3, 0, 0.1, 0.1, 0)])
        >>> min_pedestrian_distance(met).round(3)
        array([1.7])

    Reference:
        DH_min of Francis et al. 2023 (arXiv 2306.16740).
    """
    found = np.where(trajectory.is_sample, _nearest(trajectory), np.inf).min(axis=1)
    touched = np.isin(trajectory.contact, (Contact.PEDESTRIAN, Contact.HIT_BY_PEDESTRIAN))
    return np.where(touched, 0.0, found)


def mean_pedestrian_distance(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m, the mean distance to the nearest pedestrian; infinite without any.

    Example:
        >>> met = Trajectory.of_positions([(0, 0), (1, 0)], people=[(3, 0, 0.1, 0.1, 0)])
        >>> mean_pedestrian_distance(met).round(3)  # of 2.7 m and 1.7 m
        array([2.2])

    Reference:
        DH_avg of Francis et al. 2023.
    """
    return mean(_nearest(trajectory), trajectory.is_sample)


def beyond_intimate(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` in [0, 1], share of samples with all pedestrians beyond 0.45 m.

    Example:
        >>> met = Trajectory.of_positions([(0, 0), (2.5, 0)], people=[(3, 0, 0.1, 0.1, 0)])
        >>> beyond_intimate(met)  # 2.7 m, then 0.2 m
        array([0.5])

    Reference:
        Space compliance of Francis et al. 2023; SocNavGym (Kapoor et al. 2023) and the iGibson
        Social Navigation Challenge with a threshold of 0.5 m or 0.45 m.
    """
    return mean(_nearest(trajectory) > INTIMATE_M, trajectory.is_sample)


def beyond_personal(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` in [0, 1], share of samples with all pedestrians beyond 1.2 m.

    Example:
        >>> met = Trajectory.of_positions([(0, 0), (2, 0)], people=[(3, 0, 0.1, 0.1, 0)])
        >>> beyond_personal(met)  # 2.7 m, then 0.7 m
        array([0.5])

    Reference:
        Proxemics of HuNavSim (Perez-Higueras et al. 2023), surface to surface as here.
    """
    return mean(_nearest(trajectory) > PERSONAL_M, trajectory.is_sample)


def min_time_to_collision(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` s, the minimum time to a contact at constant velocities.

    Robot and pedestrians are discs here, pedestrians with the larger half side of their cuboid as
    radius; velocities are those of the last step. Infinite without a collision course, zero after a
    contact with a pedestrian.

    Example:
        >>> drive = [(0, 0), (0.2, 0)]  # at 1 m/s, then 2.5 m before a contact
        >>> met = Trajectory.of_positions(drive, people=[(3, 0, 0.1, 0.1, 0)])
        >>> min_time_to_collision(met).round(3)
        array([2.5])

    Reference:
        TTC of Francis et al. 2023, constant velocities.
    """
    robot = trajectory.pose[..., :2][:, :, None]
    people = trajectory.pedestrians[..., :2]
    reach = trajectory.robot_radius + trajectory.pedestrians[..., 2:4].max(axis=-1)
    offset, approach = people - robot, np.diff(people - robot, axis=1) / trajectory.time_step_s
    time_s = _time_to_contact(offset[:, 1:], approach, reach[:, 1:])
    counted = trajectory.is_whole_step[..., None] & ~np.isnan(time_s)
    found = np.where(counted, time_s, np.inf).min(axis=(1, 2), initial=np.inf)
    touched = np.isin(trajectory.contact, (Contact.PEDESTRIAN, Contact.HIT_BY_PEDESTRIAN))
    return np.where(touched, 0.0, found)


def _nearest(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E, T + 1]`` m to the nearest pedestrian."""
    return trajectory.clearances.min(axis=-1, initial=np.inf)


def _time_to_contact(offset: np.ndarray, velocity: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return s until a point at ``offset [..., 2]`` comes within ``reach [...]`` of the origin."""
    a = (velocity**2).sum(axis=-1)
    b = (offset * velocity).sum(axis=-1)
    c = (offset**2).sum(axis=-1) - reach**2
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b**2 - a * c)  # NaN without a contact
        first = np.where((b < 0) & ~np.isnan(root), (-b - root) / a, np.inf)
        first = np.where(c <= 0, 0.0, first)
    return np.where(np.isnan(c), np.nan, first)
