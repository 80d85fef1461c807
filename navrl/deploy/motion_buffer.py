"""Recent poses of a robot, interpolated in time."""

from __future__ import annotations

from collections import deque

import numpy as np
import torch

from navrl.ops import se2
from navrl.ops.unicycle import advance_pose

_MAX_AHEAD_S = 0.5  # of an extrapolation at constant velocity


class MotionBuffer:
    """Poses in a frame that does not jump, such as odometry, with their velocities.

    Args:
        duration_s: Age after which a pose is dropped, s.

    Example:
        >>> motion = MotionBuffer()
        >>> motion.add(0.0, (0.0, 0.0, 0.0), (1.0, 0.0))
        >>> motion.add(0.2, (0.2, 0.0, 0.0), (1.0, 0.0))
        >>> motion.pose_at(0.1).tolist(), motion.pose_at(0.3).round(2).tolist()
        ([0.1, 0.0, 0.0], [0.3, 0.0, 0.0])
    """

    def __init__(self, duration_s: float = 5.0) -> None:
        """Store the duration."""
        self.duration_s = duration_s
        self._samples: deque[tuple[float, np.ndarray, tuple[float, float]]] = deque()

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self._samples)

    @property
    def stamp(self) -> float:
        """Time of the latest pose, s; -inf without one."""
        return self._samples[-1][0] if self._samples else -np.inf

    @property
    def velocity(self) -> tuple[float, float]:
        """Velocity (v, w) of the latest pose, m/s and rad/s; zero without one."""
        return self._samples[-1][2] if self._samples else (0.0, 0.0)

    def clear(self) -> None:
        """Drop all poses."""
        self._samples.clear()

    def add(
        self,
        stamp: float,
        pose: tuple[float, float, float] | np.ndarray,
        velocity: tuple[float, float],
    ) -> None:
        """Add a pose ``[3]`` (x, y, yaw), m and rad; one that is not newer is ignored."""
        if stamp <= self.stamp:
            return
        self._samples.append((stamp, np.array(pose, dtype=np.float64), velocity))
        while self._samples[0][0] < stamp - self.duration_s:
            self._samples.popleft()

    def drop_after(self, stamp: float) -> bool:
        """Drop the poses after a time, s; return whether there were any."""
        count = len(self._samples)
        while self._samples and self._samples[-1][0] > stamp:
            self._samples.pop()
        return len(self._samples) < count

    def pose_at(self, stamp: float) -> np.ndarray:
        """Return the pose ``[3]`` at a time, m and rad, float64.

        Between two poses it is interpolated, after the latest one extrapolated with its velocity
        for up to 0.5 s, and before the earliest one it is the earliest.

        Raises:
            IndexError: If there is no pose.
        """
        after = None
        for sample in reversed(self._samples):
            if sample[0] <= stamp:
                return self._between(sample, after, stamp)
            after = sample
        return self._samples[0][1].copy()

    def _between(self, before: tuple, after: tuple | None, stamp: float) -> np.ndarray:
        start, pose, velocity = before
        if after is None:
            ahead = min(stamp - start, _MAX_AHEAD_S)
            return driven_pose(pose, velocity, ahead)
        share = torch.tensor([(stamp - start) / (after[0] - start)], dtype=torch.float64)
        end = torch.from_numpy(after[1])
        return se2.interpolate(torch.from_numpy(pose), end, share)[0].numpy()


def driven_pose(pose: np.ndarray, velocity: tuple[float, float], duration: float) -> np.ndarray:
    """Return the pose ``[3]`` after driving at (v, w) for a time, m/s, rad/s and s.

    Example:
        >>> driven_pose(np.zeros(3), (0.5, 0.0), 2.0).tolist()
        [1.0, 0.0, 0.0]
    """
    x, y, yaw = pose.tolist()
    return np.array(advance_pose(x, y, yaw, *velocity, duration))


def relative_pose(target: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Return the pose ``source`` in the frame of the pose ``target``, ``[..., 3]`` m and rad.

    Example:
        >>> relative_pose(np.array([1.0, 0.0, 0.0]), np.array([3.0, 1.0, 0.5])).tolist()
        [2.0, 1.0, 0.5]
    """
    return se2.relative(torch.from_numpy(target), torch.from_numpy(source)).numpy()


def composed_pose(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the pose ``second``, given in the frame of the pose ``first``, in the outer frame.

    Example:
        >>> composed_pose(np.array([1.0, 0.0, 0.0]), np.array([2.0, 1.0, 0.5])).tolist()
        [3.0, 1.0, 0.5]
    """
    return se2.compose(torch.from_numpy(first), torch.from_numpy(second)).numpy()
