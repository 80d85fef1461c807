"""Latest scan, motion, pose and path of a robot, with their stamps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from navrl.checks import checked_numbers, checked_pose, is_finite
from navrl.deploy.control_limits import ControlLimits
from navrl.deploy.motion_buffer import MotionBuffer, composed_pose, driven_pose, relative_pose
from navrl.deploy.paths import simplified_path
from navrl.deploy.safety import DriveState
from navrl.ops.scanner import Scanner

_MIN_EQUAL = 3  # scans; two equal ones may be one message that was received twice

ScanLimits: TypeAlias = tuple[float | None, float | None, float | None, float | None]
"""Smallest angle and increment, rad, smallest and largest range, m; None for the scanner's."""


@dataclass(frozen=True)
class StampedScan:
    """A scan as it was received.

    Args:
        stamp: Time of the first beam, s.
        ranges: ``[M]`` float64 m.
        scanner: Its angles and limits.
        duration_s: Time from the first to the last beam, s.
    """

    stamp: float
    ranges: np.ndarray
    scanner: Scanner
    duration_s: float

    @property
    def last_stamp(self) -> float:
        """Time of the last beam, s."""
        return self.stamp + self.duration_s


class RobotInputs:
    """Inputs of a controller; not thread-safe, the controller holds its lock.

    A value that is refused also drops the one before it, so that a broken source stops the robot;
    of odometry, the motion until then is retained. A stamp that is in the future of a tick is
    dropped there, so that later ones are used; between ticks, time may pass.

    Args:
        scanner: Mount and readings of the lidar; angles of scans that come without.
    """

    def __init__(self, scanner: Scanner) -> None:
        """Start without inputs."""
        self.scanner = scanner
        self.odometry, self.commanded = MotionBuffer(), MotionBuffer()
        self.scan: StampedScan | None = None
        self.path: np.ndarray | None = None
        self.path_count = 0
        self._pose: tuple[float, np.ndarray] | None = None
        self._map_from_odometry: np.ndarray | None = None
        self._unchanged_since, self._num_equal = -math.inf, 0
        self._refused: dict[str, str] = {}  # reason by kind, until the next usable value

    def clear(self) -> None:
        """Drop all values but the path."""
        self.odometry.clear()
        self.commanded.clear()
        self.scan = self._pose = self._map_from_odometry = None
        self._refused.clear()

    @property
    def motion(self) -> MotionBuffer:
        """Odometry, or the motion by the commands if there is none."""
        return self.odometry if len(self.odometry) else self.commanded

    def set_scan(
        self,
        stamp: float,
        ranges: ArrayLike,
        limits: ScanLimits,
        duration_s: float | None,
    ) -> bool:
        """Store a scan if it is newer than the last one; return whether it is stored."""
        before, self.scan = self.scan, None
        with self._noting("scan"):
            found = self._checked_scan(stamp, ranges, limits, duration_s)
        if before is not None and stamp <= before.stamp:
            self.scan = before
            return False
        self._num_equal += 1
        if before is None or not np.array_equal(found.ranges, before.ranges, equal_nan=True):
            self._unchanged_since, self._num_equal = stamp, 1
        self.scan = found
        self._refused.pop("scan", None)
        return True

    def _checked_scan(
        self,
        stamp: float,
        ranges: ArrayLike,
        limits: ScanLimits,
        duration_s: float | None,
    ) -> StampedScan:
        self._check_stamp(stamp)
        readings = checked_numbers("ranges", ranges, "[beams] numbers (m)")  # copy: buffers change
        if readings.ndim != 1 or not len(readings):
            raise ValueError(f"ranges.shape={list(readings.shape)}: must be [beams], at least 1")
        scanner = self.scanner.of_scan(len(readings), *limits)
        duration = scanner.revolution_s if duration_s is None else duration_s
        if not (is_finite(duration) and duration >= 0.0):
            raise ValueError(f"duration_s={duration!r}: must be finite and >= 0")
        return StampedScan(float(stamp), readings, scanner, float(duration))

    def set_odometry(self, stamp: float, pose: ArrayLike, velocity: ArrayLike) -> bool:
        """Store odometry if it is newer than the last one; return whether it is stored."""
        with self._noting("odometry"):
            self._check_stamp(stamp)
            allowed = "2 finite numbers (v, w)"
            speeds = checked_numbers("velocity", velocity, allowed)
            if speeds.shape != (2,) or not np.isfinite(speeds).all():
                raise ValueError(f"velocity={speeds.tolist()}: must be {allowed}")
            values = checked_pose("pose", pose)
        v, w = speeds.tolist()
        is_newer = stamp > self.odometry.stamp
        if not len(self.odometry):
            self._map_from_odometry = None  # it was that of the commands
        self.odometry.add(float(stamp), values, (v, w))
        if is_newer:
            self._refused.pop("odometry", None)
        return is_newer

    def set_pose(self, stamp: float, pose: ArrayLike) -> bool:
        """Store a pose unless it is older than the last one; return whether it is stored."""
        before, self._pose = self._pose, None
        with self._noting("pose"):
            self._check_stamp(stamp)
            values = checked_pose("pose", pose)
        if before is not None and stamp < before[0]:
            self._pose = before
            return False
        self._pose, self._map_from_odometry = (float(stamp), values), None
        self._refused.pop("pose", None)
        return True

    @contextmanager
    def _noting(self, kind: str) -> Iterator[None]:
        """Note why a value of a kind is refused."""
        try:
            yield
        except ValueError as error:
            self._refused[kind] = f"{kind} refused: {error}"
            raise

    def _check_stamp(self, stamp: float) -> None:
        """Check that a time is finite.

        Raises:
            ValueError: If it is not.
        """
        if not is_finite(stamp):
            raise ValueError(f"stamp={stamp!r}: must be finite (s)")

    def drop_future(self, now: float, skew: float) -> int:
        """Drop values that are stamped more than ``skew`` after ``now``, s; return their number."""
        last = now + skew
        stamps = {"odometry": self.odometry.stamp}
        if self.scan is not None:
            stamps["scan"] = self.scan.stamp
        if self._pose is not None:
            stamps["pose"] = self._pose[0]
        ahead = {kind: stamp for kind, stamp in stamps.items() if stamp > last}
        for kind, stamp in ahead.items():
            self._refused[kind] = f"{kind} stamped {stamp - now:.2f} s in the future"
        self.odometry.drop_after(last)
        self.scan = None if "scan" in ahead else self.scan
        self._pose = None if "pose" in ahead else self._pose
        return len(ahead)

    def set_path(self, path: ArrayLike | None) -> None:
        """Store a path of any length; ``None`` drops the last one."""
        self.path = None
        if path is None:
            return
        self.path = simplified_path(path)
        self.path_count += 1

    def advance(self, now: float, command: tuple[float, float], duration: float) -> None:
        """Integrate a command (v, w) that was held for ``duration`` until ``now``, s."""
        moved = self.commanded
        pose = moved.pose_at(moved.stamp) if len(moved) else np.zeros(3)
        moved.add(now, driven_pose(pose, command, duration), command)

    def state(self, now: float, limits: ControlLimits) -> tuple[DriveState, str]:
        """Return the state that follows from the inputs and their ages, and its reason.

        ``DRIVE`` means that the policy may decide.
        """
        if self.path is None:
            return DriveState.NO_PATH, "no path"
        age = self.scan_age(now)
        if not age <= limits.scan_timeout_s or not math.isfinite(now):
            return DriveState.STALE_SCAN, self._refused.get("scan", f"last scan {age:.2f} s old")
        age, localized = self.pose_age(now)
        if not age <= limits.pose_timeout_s or not localized <= limits.localization_timeout_s:
            reason = f"last pose {localized:.2f} s, odometry {age:.2f} s old"
            refused = self._refused.get("pose", self._refused.get("odometry", reason))
            return DriveState.STALE_POSE, refused
        if self.is_frozen(limits.frozen_motion):
            return DriveState.BLIND, "the lidar repeats one scan although the robot moves"
        return DriveState.DRIVE, ""

    def scan_age(self, now: float) -> float:
        """Return the age of the last beam, s; inf without a scan."""
        return math.inf if self.scan is None else now - self.scan.last_stamp

    def goal_distance(self, now: float) -> float | None:
        """Return the distance from the robot to the path's last point, m."""
        pose = self.pose_at(now)
        if pose is None or self.path is None:
            return None
        return float(np.hypot(*(self.path[-1] - pose[:2])))

    def pose_at(self, now: float) -> np.ndarray | None:
        """Return the pose ``[3]`` in the path's frame: the latest, moved on by the motion since."""
        if self._pose is None or not math.isfinite(now):
            return None
        stamp, pose = self._pose
        if not len(self.motion):
            return pose.copy()
        if self._map_from_odometry is None or not len(self.odometry):
            there = self.motion.pose_at(stamp)
            self._map_from_odometry = composed_pose(pose, relative_pose(there, np.zeros(3)))
        return composed_pose(self._map_from_odometry, self.motion.pose_at(now))

    def pose_age(self, now: float) -> tuple[float, float]:
        """Return the age of the latest odometry or pose, and that of the latest pose, s."""
        if self._pose is None:
            return math.inf, math.inf
        age = now - self._pose[0]
        if "odometry" in self._refused:
            return math.inf, age
        return (now - self.odometry.stamp if len(self.odometry) else age), age

    def scan_motion(self, now: float) -> np.ndarray | None:
        """Return the robot's frames ``[2, 3]`` at the first and last beam, in that at ``now``."""
        if self.scan is None or not len(self.motion):
            return None
        stamps = (min(self.scan.stamp, now), min(self.scan.last_stamp, now))
        then = np.stack([self.motion.pose_at(stamp) for stamp in stamps])
        return relative_pose(self.motion.pose_at(now)[None], then)

    def is_frozen(self, distance: float) -> bool:
        """Return whether the robot has moved while its lidar repeated the same scan."""
        scan = self.scan
        if scan is None or self._num_equal < _MIN_EQUAL or not len(self.odometry):
            return False
        moved = relative_pose(
            self.odometry.pose_at(self._unchanged_since), self.odometry.pose_at(scan.stamp)
        )
        return math.hypot(moved[0], moved[1]) > distance or abs(moved[2]) > distance
