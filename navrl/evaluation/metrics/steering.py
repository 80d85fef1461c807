"""Steering metrics: changes of the driven command (v, w) from step to step.

The driven command is what the simulator was given, after the transforms of the policy's action; a
shield may have replaced the requested one. The change from rest at the start is excluded. A step
cut short by a contact counts, since its command was given. Percentiles are of the steps of one
episode; a summary has their mean over episodes. NaN if an episode is too short or the command is
not (v, w).
"""

from __future__ import annotations

import numpy as np

from navrl.evaluation.metrics.efficiency import path_length
from navrl.evaluation.metrics.motion import cumulative_heading_change
from navrl.evaluation.metrics.trajectory import Trajectory, largest, mean

REVERSAL_TURN_RATE = 0.5  # rad/s on both sides of a reversal
SETTLING_TIME = 1.0  # s after the start in which any turn rate is allowed


def turn_reversals(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` share of steps that reverse w, from and to more than 0.5 rad/s.

    Example:
        >>> turns = [(1.0, 0.6), (1.0, -0.6), (1.0, 0.4), (1.0, 0.6), (1.0, 0.6)]
        >>> turn_reversals(Trajectory.of_positions([(0, 0)] * 6, command=turns))
        array([0.25])

    Reference:
        Ours.
    """
    w = trajectory.command[..., 1]
    before, after = w[:, :-1], w[:, 1:]
    strong = np.minimum(np.abs(before), np.abs(after)) > REVERSAL_TURN_RATE
    return mean(1.0 * (strong & (before * after < 0.0)), trajectory.is_command[:, 1:])


def speed_change_p90(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m/s, 90th percentile of the absolute change of v per step.

    Example:
        >>> drive = [(v, 0.0) for v in (0.0, 0.1, 0.3)]
        >>> speed_change_p90(Trajectory.of_positions([(0, 0)] * 4, command=drive)).round(3)
        array([0.19])

    Reference:
        Ours; linear interpolation between steps.
    """
    return _percentile_of_change(trajectory, 0, 90)


def speed_change_p95(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m/s, 95th percentile of the absolute change of v per step.

    Example:
        >>> drive = [(v, 0.0) for v in (0.0, 0.1, 0.3)]
        >>> speed_change_p95(Trajectory.of_positions([(0, 0)] * 4, command=drive)).round(3)
        array([0.195])

    Reference:
        Ours; linear interpolation between steps.
    """
    return _percentile_of_change(trajectory, 0, 95)


def turn_rate_change_p90(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` rad/s, 90th percentile of the absolute change of w per step.

    Example:
        >>> drive = [(1.0, w) for w in (0.0, 1.0, -1.0)]
        >>> turn_rate_change_p90(Trajectory.of_positions([(0, 0)] * 4, command=drive)).round(3)
        array([1.9])

    Reference:
        Ours; linear interpolation between steps.
    """
    return _percentile_of_change(trajectory, 1, 90)


def turn_rate_change_p95(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` rad/s, 95th percentile of the absolute change of w per step.

    Example:
        >>> drive = [(1.0, w) for w in (0.0, 1.0, -1.0)]
        >>> turn_rate_change_p95(Trajectory.of_positions([(0, 0)] * 4, command=drive)).round(3)
        array([1.95])

    Reference:
        Ours; linear interpolation between steps.
    """
    return _percentile_of_change(trajectory, 1, 95)


def max_turn_rate(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` rad/s, the largest absolute w of a command after the first second.

    On the suite ``straight``, a straight path of 5 m without obstacles, it should be near zero.

    Example:
        >>> drive = [(1.0, 2.0), (1.0, -0.1), (1.0, 0.0)]
        >>> max_turn_rate(Trajectory.of_positions([(0, 0)] * 4, command=drive, time_step_s=1.0))
        array([0.1])

    Reference:
        Ours.
    """
    w = np.abs(trajectory.command[..., 1])
    started = np.arange(w.shape[1]) * trajectory.time_step_s >= SETTLING_TIME - 1e-6
    return largest(w, trajectory.is_command & started)


def turned_per_meter(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` rad/m, the sum of absolute heading changes over the driven distance.

    Example:
        >>> drive = [(0, 0), (1, 0), (2, 0)]
        >>> turned_per_meter(Trajectory.of_positions(drive, yaw=[0.0, 0.5, 0.25]))
        array([0.375])

    Reference:
        Ours; NaN for a robot that did not move.
    """
    driven = path_length(trajectory)
    turned = cumulative_heading_change(trajectory)
    return np.where(driven > 0.0, turned / np.where(driven > 0.0, driven, 1.0), np.nan)


def shielded(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` share of steps in which the driven command is not the policy's.

    Example:
        >>> drive = Trajectory.of_positions(
        ...     [(0, 0)] * 3, command=[(1.0, 0.0), (0.0, 0.0)], requested=[(1.0, 0.0), (1.0, 0.0)]
        ... )
        >>> shielded(drive)
        array([0.5])

    Reference:
        Ours; NaN for recordings without the requested command.
    """
    differs = (trajectory.command != trajectory.requested).any(-1)
    known = trajectory.is_command & ~np.isnan(trajectory.requested).any(-1)
    return mean(1.0 * differs, known)


def _percentile_of_change(trajectory: Trajectory, axis: int, percent: float) -> np.ndarray:
    """Return the percentile ``[E]`` of the absolute changes of one entry of the command.

    Episode by episode, so that none depends on the others of its batch.
    """
    changes = np.abs(np.diff(trajectory.command[..., axis], axis=1))
    counted = trajectory.is_command[:, 1:]
    rows = (change[mask] for change, mask in zip(changes, counted, strict=True))
    return np.array([np.percentile(row, percent) if len(row) else np.nan for row in rows])
