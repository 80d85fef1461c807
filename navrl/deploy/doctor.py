"""Measurements of a log: what a policy would see of its scans, stamps, poses and frames."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from navrl.deploy.bags.messages import (
    LoggedCommand,
    LoggedOdometry,
    LoggedPose,
    LoggedScan,
)
from navrl.deploy.bags.sources import LogSource
from navrl.deploy.motion_buffer import MotionBuffer, relative_pose
from navrl.deploy.mount_guess import (
    FINE,
    PAIR_M,
    PAIR_RAD,
    MountGuess,
    aligned,
    mount_by_motion,
    true_sectors,
)
from navrl.deploy.safety import DriveState, SafetyLimits, ScanCheck
from navrl.deploy.scan_adapter import adapt_scan
from navrl.ops.scanner import Scanner
from navrl.sim import Lidar, RobotModel

_NUM_SAMPLES = 100  # scans that are resampled, evenly spaced over the log
_NUM_PAIRS = 60  # of scans, for the mount
_OWN_M, _OWN_SHARE = 0.4, 0.95  # readings nearer than this in almost all scans are of the robot
_OWN_DRIVEN_M = 1.0  # walls are not near for so long


@dataclass(eq=False)
class LogMeasures:
    """Measurements of a log.

    Args:
        num_scans: Number of scans.
        beams: Numbers of beams that occur.
        angles: (angle_min, angle_increment) that occur, rad, rounded to 1e-6.
        limits: (range_min, range_max) that occur, m.
        frames: Frames of the scans.
        stamps: ``[S]`` s of the scans.
        ages: ``[S]`` s from the stamp to the reception.
        readings: Share of each kind of reading.
        largest_reading: Median of the scans' largest finite reading, m.
        states: Scans by the state that their check gives.
        pose_stamps: ``[P]`` s of the poses' reception.
        pose_ages: ``[P]`` s from the stamp to the reception.
        odometry_stamps: ``[O]`` s.
        driven_m: Length of the driven path by odometry, or else by poses, m.
        speeds: Smallest and largest v, and largest abs(w), of odometry and commands, m/s and rad/s.
        mount: Mount by the motion of the scans.
        own_sectors: (bearing, width) in the scanner's frame, rad, of readings of the robot itself.
        sample: ``[N]`` m, a scan of the middle of the log as the policy gets it.
        num_refused: Scans that cannot be resampled, with the first reason.
    """

    num_scans: int = 0
    beams: set[int] = field(default_factory=set)
    angles: set[tuple[float, float]] = field(default_factory=set)
    limits: set[tuple[float, float]] = field(default_factory=set)
    frames: set[str] = field(default_factory=set)
    stamps: np.ndarray = field(default_factory=lambda: np.zeros(0))
    ages: np.ndarray = field(default_factory=lambda: np.zeros(0))
    readings: dict[str, float] = field(default_factory=dict)
    largest_reading: float = math.nan
    states: Counter[DriveState] = field(default_factory=Counter)
    pose_stamps: np.ndarray = field(default_factory=lambda: np.zeros(0))
    pose_ages: np.ndarray = field(default_factory=lambda: np.zeros(0))
    odometry_stamps: np.ndarray = field(default_factory=lambda: np.zeros(0))
    driven_m: float = 0.0
    speeds: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount: MountGuess = field(default_factory=lambda: MountGuess(None, 0.0, None, 0))
    own_sectors: list[tuple[float, float]] = field(default_factory=list)
    sample: np.ndarray | None = None
    num_refused: tuple[int, str] = (0, "")


def measure_log(
    source: LogSource, scanner: Scanner, lidar: Lidar, robot: RobotModel
) -> LogMeasures:
    """Read a log once and measure it.

    Args:
        source: The log.
        scanner: Its lidar with the mount.
        lidar: Lidar of the policy.
        robot: Robot of the policy.
    """
    reader = _Reader(source, scanner, lidar, robot)
    for message in source.messages():
        reader.add(message)
    return reader.measures()


class _Reader:
    """Accumulator of :func:`measure_log`."""

    def __init__(
        self, source: LogSource, scanner: Scanner, lidar: Lidar, robot: RobotModel
    ) -> None:
        self.found = LogMeasures()
        self._scanner, self._lidar = scanner, lidar
        self._check = ScanCheck(lidar, robot, SafetyLimits())
        self._stride = max(1, source.log.topics[source.scan].count // _NUM_SAMPLES)
        self._counts: Counter[str] = Counter()
        self._scans: list[tuple[float, float, float]] = []
        self._poses: list[tuple[float, float]] = []
        self._odometry: list[float] = []
        self._speeds: list[tuple[float, float]] = [(0.0, 0.0)]
        self._motion, self._has_odometry = MotionBuffer(), source.odometry is not None
        self._place: np.ndarray | None = None
        self._anchor: tuple[np.ndarray, np.ndarray] | None = None
        self._moves: list[tuple[np.ndarray, np.ndarray]] = []
        self._near = np.zeros(FINE.num_beams)
        self._num_fine = 0

    def add(self, message: object) -> None:
        """Add a message."""
        if isinstance(message, LoggedScan):
            self._add_scan(message)
        elif isinstance(message, LoggedOdometry):
            self._odometry.append(message.stamp)
            self._speeds.append(message.velocity)
            self._move(message.stamp, message.pose)
        elif isinstance(message, LoggedPose):
            self._poses.append((message.received, message.received - message.stamp))
            if not self._has_odometry:
                self._move(message.stamp, message.pose)
        elif isinstance(message, LoggedCommand):
            self._speeds.append(message.command)

    def _move(self, stamp: float, pose: tuple[float, float, float]) -> None:
        now = np.array(pose)
        if not np.isfinite(now).all():
            return
        if self._place is not None:
            self.found.driven_m += float(np.hypot(*(now - self._place)[:2]))
        self._place = now
        self._motion.add(stamp, now, (0.0, 0.0))

    def _add_scan(self, scan: LoggedScan) -> None:
        found, ranges = self.found, scan.ranges
        found.num_scans += 1
        found.beams.add(len(ranges))
        found.angles.add((round(scan.angle_min, 6), round(scan.angle_increment, 6)))
        found.limits.add((scan.range_min, scan.range_max))
        found.frames.add(scan.frame)
        finite = ranges[np.isfinite(ranges)]
        largest = float(finite.max()) if len(finite) else math.nan
        self._scans.append((scan.stamp, scan.received - scan.stamp, largest))
        self._counts.update(reading_kinds(ranges, scan.range_min, scan.range_max))
        if (found.num_scans - 1) % self._stride == 0:
            self._resample(scan)
        try:
            self._pair(scan)
        except ValueError:
            return  # counted by _resample

    def _resample(self, scan: LoggedScan) -> None:
        """Give the scan to the policy's check, as the control loop does."""
        try:
            given = scan_layout(self._scanner, scan)
            adapted = adapt_scan(scan.ranges, given, self._lidar).ranges
        except ValueError as error:
            count, reason = self.found.num_refused
            self.found.num_refused = (count + 1, reason or str(error))
            return
        self.found.states[self._check.state(adapted)] += 1
        if self.found.sample is None or self.found.num_scans <= self._stride * _NUM_SAMPLES // 2:
            self.found.sample = adapted

    def _pair(self, scan: LoggedScan) -> None:
        """Align the scan with an earlier one if the robot has moved in between."""
        tried = max(len(self._moves), self._num_fine // 3)
        if tried >= _NUM_PAIRS or not len(self._motion):
            return
        pose = self._motion.pose_at(scan.stamp)
        if self._anchor is not None:
            moved = relative_pose(pose, self._anchor[0])
            if math.hypot(moved[0], moved[1]) < PAIR_M and abs(moved[2]) < PAIR_RAD:
                return
        plain = Scanner(range_min=scan.range_min, range_max=scan.range_max)
        distance = adapt_scan(scan.ranges, scan_layout(plain, scan), FINE).distances
        self._near += (distance < _OWN_M) & (distance > 0.0)
        self._num_fine += 1
        before, self._anchor = self._anchor, (pose, distance)
        if before is None:
            return
        found = aligned(before[1], distance)
        if found is not None:
            self._moves.append((relative_pose(pose, before[0]), found))

    def measures(self) -> LogMeasures:
        """Return the measurements after the last message."""
        found, scans = self.found, np.array(self._scans).reshape(-1, 3)
        found.stamps, found.ages = scans[:, 0], scans[:, 1]
        known = scans[np.isfinite(scans[:, 2]), 2]
        found.largest_reading = float(np.median(known)) if len(known) else math.nan
        total = max(sum(self._counts.values()), 1)
        found.readings = {name: count / total for name, count in self._counts.items() if count}
        poses = np.array(self._poses).reshape(-1, 2)
        found.pose_stamps, found.pose_ages = poses[:, 0], poses[:, 1]
        found.odometry_stamps = np.array(self._odometry)
        speeds = np.array(self._speeds)
        found.speeds = (speeds[:, 0].min(), speeds[:, 0].max(), np.abs(speeds[:, 1]).max())
        found.mount = mount_by_motion(self._moves)
        if self._num_fine >= 5 and found.driven_m > _OWN_DRIVEN_M:
            found.own_sectors = true_sectors(self._near >= _OWN_SHARE * self._num_fine)
        return found


def scan_layout(scanner: Scanner, scan: LoggedScan) -> Scanner:
    """Return the scanner with the angles and limits of a scan, as the control loop reads it.

    Raises:
        ValueError: If the angles or limits of the scan are invalid.
    """
    limits = (scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
    return scanner.of_scan(len(scan.ranges), *limits)


def reading_kinds(ranges: np.ndarray, range_min: float, range_max: float) -> dict[str, int]:
    """Return the number of readings of each kind.

    Args:
        ranges: ``[M]`` m.
        range_min: m.
        range_max: m.

    Example:
        >>> kinds = reading_kinds(np.array([1.0, 0.0, np.inf, np.nan, 0.1]), 0.15, 12.0)
        >>> {name: count for name, count in kinds.items() if count}
        {'distance': 1, 'below range_min': 1, '0': 1, 'inf': 1, 'NaN': 1}
    """
    positive = np.isfinite(ranges) & (ranges > 0.0)
    near, far = positive & (ranges < range_min), positive & (ranges >= range_max)
    return {
        "distance": int((positive & ~near & ~far).sum()),
        "below range_min": int(near.sum()),
        "range_max or more": int(far.sum()),
        "0": int((ranges == 0.0).sum()),
        "inf": int(np.isposinf(ranges).sum()),
        "-inf": int(np.isneginf(ranges).sum()),
        "NaN": int(np.isnan(ranges).sum()),
        "negative": int((np.isfinite(ranges) & (ranges < 0.0)).sum()),
    }
