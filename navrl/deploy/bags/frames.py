"""Tree of coordinate frames from the tf messages of a log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navrl.deploy.bags.messages import FrameTransform, LoggedTransforms


class Placed(NamedTuple):
    """Result of :meth:`FrameTree.lookup`."""

    stamp: float
    """Time of the oldest transform between the frames, s; inf if all are static."""
    pose: tuple[float, float, float]
    """(x, y, yaw), m and rad."""
    tilt: float
    """Angle between the z axes of the frames, rad: pi for a lidar that hangs upside down."""


class FrameTree:
    """Latest pose of each frame in its parent.

    Example:
        >>> tree, turned = FrameTree(), homogeneous((0.1, 0.0, 0.3), (0.0, 0.0, 1.0, 0.0))
        >>> tree.add(FrameTransform("base_link", "laser", 0.0, turned, is_static=True))
        >>> tree.lookup("base_link", "laser").pose
        (0.1, 0.0, 3.141592653589793)
    """

    def __init__(self) -> None:
        """Start without frames."""
        self._parents: dict[str, FrameTransform] = {}

    @property
    def frames(self) -> list[str]:
        """Names of all frames."""
        links = self._parents.values()
        return sorted({name for each in links for name in (each.parent, each.child)})

    def add(self, transform: FrameTransform) -> None:
        """Store a transform in place of an older one of the same frame."""
        self._parents[transform.child] = transform

    def update(self, message: LoggedTransforms) -> None:
        """Store the transforms of a message."""
        for transform in message.transforms:
            self.add(transform)

    def lookup(self, target: str, source: str) -> Placed | None:
        """Return the pose of the frame ``source`` in ``target``; None if they are not connected."""
        up, down = self._to_root(source), self._to_root(target)
        if up is None or down is None:
            return None
        shared = next((frame for frame in up if frame in down), None)
        if shared is None:
            return None
        (first, start), (second, end) = up[shared], down[shared]
        matrix = np.linalg.inv(second) @ first
        yaw = math.atan2(matrix[1, 0], matrix[0, 0])
        tilt = math.acos(min(max(float(matrix[2, 2]), -1.0), 1.0))
        return Placed(min(start, end), (float(matrix[0, 3]), float(matrix[1, 3]), yaw), tilt)

    def _to_root(self, frame: str) -> dict[str, tuple[np.ndarray, float]] | None:
        """Return the pose of a frame in itself and each ancestor, and the oldest stamp until it."""
        matrix, stamp = np.eye(4), math.inf
        found = {frame: (matrix, stamp)}
        while frame in self._parents:
            link = self._parents[frame]
            matrix = link.matrix @ matrix
            stamp = stamp if link.is_static else min(stamp, link.stamp)
            frame = link.parent
            if frame in found:  # a circle
                return None
            found[frame] = (matrix, stamp)
        return found


def homogeneous(place: Sequence[float], turn: Sequence[float]) -> np.ndarray:
    """Return the homogeneous matrix ``[4, 4]`` of a place and a quaternion.

    Args:
        place: (x, y, z), m.
        turn: (x, y, z, w), of any length but zero.

    Raises:
        ValueError: If a value is not finite or the quaternion is zero.
    """
    values = np.array([*place, *turn], dtype=np.float64)
    length = float(np.linalg.norm(values[3:]))
    if not np.isfinite(values).all() or length < 1e-6:
        raise ValueError(f"transform={values.tolist()}: must be finite, its quaternion not zero")
    x, y, z, w = values[3:] / length
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = values[:3]
    return matrix
