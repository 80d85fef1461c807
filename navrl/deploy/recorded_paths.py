"""Paths for the replay of a log: recorded, along the robot's trajectory, or to a goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from navrl.checks import check_positive, checked_numbers

_SPACING_M = 0.05  # between points of a trajectory; nearer ones are noise of a standing robot


class PathPlan(Protocol):
    """Source of the paths of a replay."""

    reads_topic: bool
    """Whether the paths of the log are given to the controller."""

    def path_at(self, now: float, pose: np.ndarray | None) -> np.ndarray | None:
        """Return a new path ``[P, 2]`` m for the controller at a time, None to keep the last."""
        ...


class TopicPaths:
    """Paths as they were planned while the log was recorded."""

    reads_topic = True

    def path_at(self, now: float, pose: np.ndarray | None) -> np.ndarray | None:
        """Return None: the messages are given to the controller."""
        return None


class GoalPath:
    """Straight path from the first pose to a goal.

    Args:
        goal: (x, y) in the frame of the poses, m.

    Raises:
        ValueError: If ``goal`` is not two finite numbers.
    """

    reads_topic = False

    def __init__(self, goal: Sequence[float]) -> None:
        """Check and store the goal."""
        allowed = "2 finite numbers (x, y) in m"
        found = checked_numbers("goal", goal, allowed)
        if found.shape != (2,) or not np.isfinite(found).all():
            raise ValueError(f"goal={found.tolist()}: must be {allowed}")
        self._goal, self._is_given = found, False

    def path_at(self, now: float, pose: np.ndarray | None) -> np.ndarray | None:
        """Return the path once, when the first pose is known."""
        if self._is_given or pose is None:
            return None
        self._is_given = True
        return np.stack([np.asarray(pose, dtype=np.float64)[:2], self._goal])


class TrajectoryPaths:
    """Paths along the trajectory that the robot drives next in the log, as a planner's.

    A path ends at the farthest point of the next ``horizon_m``, so that a robot that returns is not
    at its goal at once.

    Args:
        times: ``[T]`` s of the poses.
        poses: ``[T, 3]`` or ``[T, 2]`` recorded positions, m.
        horizon_m: Length of the trajectory ahead, m.
        period_s: Time between two paths, s.

    Raises:
        ValueError: If there is no pose or a value is not positive.

    Example:
        >>> driven = np.stack([0.1 * np.arange(100), np.zeros(100)], axis=1)
        >>> paths = TrajectoryPaths(np.arange(100.0), driven, horizon_m=2.0)
        >>> paths.path_at(10.0, None)[[0, -1]].round(2).tolist()
        [[1.0, 0.0], [3.0, 0.0]]
    """

    reads_topic = False

    def __init__(
        self,
        times: np.ndarray,
        poses: np.ndarray,
        horizon_m: float = 10.0,
        period_s: float = 1.0,
    ) -> None:
        """Thin the trajectory to points that are apart."""
        check_positive(horizon_m=horizon_m, period_s=period_s)
        if not len(times):
            raise ValueError("path=trajectory: the log must have poses")
        points = np.asarray(poses, dtype=np.float64)[:, :2]
        kept = [0]
        for k in range(1, len(points)):
            if np.hypot(*(points[k] - points[kept[-1]])) >= _SPACING_M:
                kept.append(k)
        self._times, self._points = np.maximum.accumulate(times[kept]), points[kept]
        steps = np.hypot(*np.diff(self._points, axis=0).T)
        self._length = np.concatenate([[0.0], np.cumsum(steps)])
        self._horizon, self._period, self._next = horizon_m, period_s, -math.inf

    def path_at(self, now: float, pose: np.ndarray | None) -> np.ndarray | None:
        """Return the next path once per period."""
        if now < self._next:
            return None
        self._next = now + self._period
        start = max(int(np.searchsorted(self._times, now, side="right")) - 1, 0)
        reach = self._length[start] + self._horizon + 1e-9
        ahead = self._points[start : int(np.searchsorted(self._length, reach, side="right"))]
        farthest = int(np.argmax(np.hypot(*(ahead - ahead[0]).T)))
        return ahead[: farthest + 1].copy()
