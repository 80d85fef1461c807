"""Path efficiency and time metrics."""

from __future__ import annotations

import numpy as np
import torch

from navrl.evaluation.metrics.ending import success
from navrl.evaluation.metrics.trajectory import Trajectory, total
from navrl.ops.contact import MOVING_SPEED
from navrl.ops.path import project_onto_path

_MIN_PROGRESS = 1e-3  # m per step; less is rounding


def duration(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` s from start to end; a last step cut short by a contact counts whole.

    Example:
        >>> drive = [(0, 0), (0.1, 0), (0.2, 0)]  # two steps of 0.2 s
        >>> duration(Trajectory.of_positions(drive))
        array([0.4])

    Reference:
        Paper Table I, navigation time.
    """
    return trajectory.num_steps * trajectory.time_step_s


def time_to_goal(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` s from the start to the goal; NaN where it is not reached.

    Example:
        >>> drive = [(0, 0), (0.1, 0), (0.2, 0)]
        >>> time_to_goal(Trajectory.of_positions(drive))
        array([0.4])
        >>> from navrl.envs import Outcome
        >>> time_to_goal(Trajectory.of_positions(drive, outcome=Outcome.TIMEOUT))
        array([nan])

    Reference:
        Paper Table I, navigation time of successful episodes; T of Francis et al. 2023.
    """
    return np.where(success(trajectory) > 0, duration(trajectory), np.nan)


def path_length(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` m, the sum of the distances between the samples' positions.

    Example:
        >>> path_length(Trajectory.of_positions([(0, 0), (3, 0), (3, 4)]))
        array([7.])

    Reference:
        PL of Francis et al. 2023.
    """
    return total(_moved(trajectory), trajectory.is_sample[:, 1:])


def spl(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` in [0, 1], success weighted by path length: S L* / max(L, L*).

    L* is the length of the planned path, which has more than the robot's radius of clearance and
    ignores pedestrians; L that of the driven path.

    Example:
        >>> path = [(0, 0), (3, 4)]  # 5 m, of which the robot makes 7 m
        >>> spl(Trajectory.of_positions([(0, 0), (3, 0), (3, 4)], path=path)).round(3)
        array([0.714])

    Reference:
        Anderson et al., "On Evaluation of Embodied Navigation Agents", 2018.
    """
    planned = trajectory.planned_length
    return success(trajectory) * planned / np.maximum(path_length(trajectory), planned)


def stl(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` in [0, 1], success weighted by time: S T* / max(T, T*).

    T* = L* / (the robot's maximum speed), the planned path driven without turns or stops.

    Example:
        >>> drive = [(0, 0), (0.05, 0), (0.1, 0)]  # 0.1 m in 0.4 s, at 1 m/s in 0.1 s
        >>> stl(Trajectory.of_positions(drive)).round(3)
        array([0.25])

    Reference:
        Francis et al. 2023; iGibson Social Navigation Challenge 2021. There, T* is from an optimal
        planner with the robot's dynamics; ours is a lower bound of it.
    """
    fastest = trajectory.planned_length / trajectory.max_speed
    return success(trajectory) * fastest / np.maximum(duration(trajectory), fastest)


def stalled_time(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` s of whole steps with a mean speed of at most 0.05 m/s.

    Example:
        >>> drive = [(0, 0), (0.1, 0), (0.1, 0), (0.2, 0)]  # stationary in the second step
        >>> stalled_time(Trajectory.of_positions(drive))
        array([0.2])

    Reference:
        ST of Francis et al. 2023 (v = 0); 0.05 m/s is ours, the speed below which a robot is not at
        fault for a contact.
    """
    slow = _moved(trajectory) <= MOVING_SPEED * trajectory.time_step_s
    return _seconds(trajectory, slow)


def time_without_progress(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E]`` s of whole steps without new progress along the path.

    Progress is the arc length of the position's projection on the planned path, as the policy sees
    it; driving back and forth on the same part is not progress.

    Example:
        >>> drive = [(0, 0), (0.1, 0), (0, 0), (0.1, 0), (0.2, 0)]  # back and forth
        >>> time_without_progress(Trajectory.of_positions(drive))
        array([0.4])

    Reference:
        FP, failure to progress, of Francis et al. 2023, who use the straight-line distance to the
        goal; along the path, a detour around a wall is progress too.
    """
    gained = np.diff(_progress(trajectory), axis=1)
    return _seconds(trajectory, gained < _MIN_PROGRESS)


def _moved(trajectory: Trajectory) -> np.ndarray:
    """Return ``[E, T]`` m between successive positions."""
    return np.linalg.norm(np.diff(trajectory.pose[..., :2], axis=1), axis=-1)


def _seconds(trajectory: Trajectory, steps: np.ndarray) -> np.ndarray:
    return (steps & trajectory.is_whole_step).sum(axis=1) * trajectory.time_step_s


def _progress(trajectory: Trajectory) -> np.ndarray:
    """Return the non-decreasing progress ``[E, T + 1]`` m along the planned path."""
    path = torch.from_numpy(np.asarray(trajectory.path, dtype=np.float32))
    position = torch.from_numpy(np.nan_to_num(trajectory.pose[..., :2]).astype(np.float32))
    progress, found = None, []
    for sample in position.unbind(dim=1):
        progress, _ = project_onto_path(path, sample.contiguous(), progress)
        found.append(progress)
    return torch.stack(found, dim=1).double().numpy()
