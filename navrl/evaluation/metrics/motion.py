"""Smoothness metrics: finite differences of poses at the control step, unsmoothed.

A step cut short by a contact has no known duration and is excluded. Successive speeds are one time
step apart; the acceleration from rest at the start is excluded. NaN if an episode is too short.
"""

from __future__ import annotations

import numpy as np

from navrl.evaluation.metrics.trajectory import Trajectory, largest, mean, total


def speeds(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E, T]`` m/s, distance over time of each step, never negative.

    Example:
        >>> speeds(Trajectory.of_positions([(0, 0), (1, 0), (0, 0)], time_step_s=0.5))
        array([[2., 2.]])
    """
    moved = np.linalg.norm(np.diff(trajectory.pose[..., :2], axis=1), axis=-1)
    return moved / trajectory.time_step_s


def mean_speed(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m/s, distance over time, mean of whole steps.

    Example:
        >>> mean_speed(Trajectory.of_positions([(0, 0), (1, 0), (4, 0)], time_step_s=1.0))
        array([2.])

    Reference:
        V_avg of Francis et al. 2023 (arXiv 2306.16740).
    """
    return mean(speeds(trajectory), trajectory.is_whole_step)


def max_speed(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m/s, distance over time, the largest of whole steps.

    Example:
        >>> max_speed(Trajectory.of_positions([(0, 0), (1, 0), (4, 0)], time_step_s=1.0))
        array([3.])

    Reference:
        V_max of Francis et al. 2023.
    """
    return largest(speeds(trajectory), trajectory.is_whole_step)


def mean_acceleration(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m/s^2, the mean absolute acceleration, including braking.

    Example:
        >>> drive = [(0, 0), (1, 0), (4, 0), (5, 0)]  # 1, 3 and 1 m/s
        >>> mean_acceleration(Trajectory.of_positions(drive, time_step_s=1.0))
        array([2.])

    Reference:
        A_avg of Francis et al. 2023.
    """
    return mean(*_differences(trajectory, order=1))


def max_acceleration(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m/s^2, the maximum absolute acceleration, including braking.

    Example:
        >>> drive = [(0, 0), (1, 0), (2, 0), (5, 0)]  # 1, 1 and 3 m/s
        >>> max_acceleration(Trajectory.of_positions(drive, time_step_s=1.0))
        array([2.])

    Reference:
        A_max of Francis et al. 2023.
    """
    return largest(*_differences(trajectory, order=1))


def mean_jerk(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m/s^3, the mean absolute jerk.

    Example:
        >>> drive = [(0, 0), (1, 0), (4, 0), (5, 0)]  # 1, 3 and 1 m/s; 2 and -2 m/s^2
        >>> mean_jerk(Trajectory.of_positions(drive, time_step_s=1.0))
        array([4.])

    Reference:
        J_avg of Francis et al. 2023.
    """
    return mean(*_differences(trajectory, order=2))


def max_jerk(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m/s^3, the maximum absolute jerk.

    Example:
        >>> drive = [(0, 0), (1, 0), (4, 0), (5, 0), (6, 0)]  # 2, -2 and 0 m/s^2
        >>> max_jerk(Trajectory.of_positions(drive, time_step_s=1.0))
        array([4.])

    Reference:
        J_max of Francis et al. 2023.
    """
    return largest(*_differences(trajectory, order=2))


def cumulative_heading_change(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` rad, the sum of absolute heading changes between samples.

    Example:
        >>> drive = [(0, 0), (1, 0), (2, 0)]
        >>> cumulative_heading_change(Trajectory.of_positions(drive, yaw=[0.0, 0.5, 0.25]))
        array([0.75])

    Reference:
        CHC of HuNavSim (Perez-Higueras et al. 2023). A turn of more than pi per step would be
        measured as the shorter one; the robot's limit is 0.63 rad per step.
    """
    turned = np.diff(trajectory.pose[..., 2], axis=1)
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    return total(np.abs(turned), trajectory.is_sample[:, 1:])


def _differences(trajectory: Trajectory, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the absolute order-th derivative of speed ``[E, T - order]`` and a mask."""
    value, counted = speeds(trajectory), trajectory.is_whole_step
    for _ in range(order):
        value = np.diff(value, axis=1) / trajectory.time_step_s
        counted = counted[:, 1:]
    return np.abs(value), counted
