"""Logs of the CARMEN toolkit: plain text, one message per line."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np

from navrl.deploy.bags.messages import (
    Logged,
    LoggedOdometry,
    LoggedPose,
    LoggedScan,
    Topic,
)
from navrl.deploy.motion_buffer import relative_pose
from navrl.untrusted import DamagedFileError

_REMEDY = "remove the line, or cut the log before it"
LASERS = ("FLASER", "RLASER", "ROBOTLASER1", "ROBOTLASER2")
"""Messages with a scan."""
_MAX_LINE = 200_000  # characters; a scan of 1,081 beams has about 10,000
_MAX_BEAMS = 20_000
_RANGE_MAX = 80.0  # m, FLASER has no limit; SICK LMS report 81.83 m and more for no return
_SHORT_S = 1e-3  # between two poses; shorter steps give no velocity
_Pose = tuple[float, float, float]


class CarmenLog:
    """Log of the CARMEN toolkit.

    A laser is the topic of its scans, ``FLASER``, ``RLASER``, ``ROBOTLASER1`` or ``ROBOTLASER2``;
    ``NAME/pose`` has the robot's pose that comes with a scan (corrected in corrected logs) and
    ``NAME/odometry`` the raw one, with the velocity from successive poses. ``ODOM`` has the base's
    own velocity. Ranges at or above the maximum are infinite, and so no return. The stamps are
    those of the messages; the logger's own clock is not used, it starts at zero.

    Args:
        file: Text file.

    Raises:
        DamagedFileError: If it has no message of these kinds or is no text.
    """

    def __init__(self, file: str | Path) -> None:
        """Count the messages."""
        self.file = Path(file)
        counts = Counter(words[0] for _, words in self._lines())
        self.topics: dict[str, Topic] = {}
        for name in LASERS:
            if counts[name]:
                self.topics[name] = Topic(name, "scan", name, counts[name])
                pose, moved = f"{name}/pose", f"{name}/odometry"
                self.topics[pose] = Topic(pose, "pose", name, counts[name])
                if not counts["ODOM"]:
                    self.topics[moved] = Topic(moved, "odometry", name, counts[name])
        if counts["ODOM"]:
            self.topics["ODOM"] = Topic("ODOM", "odometry", "ODOM", counts["ODOM"])
        if not self.topics:
            names = ", ".join((*LASERS, "ODOM"))
            raise DamagedFileError(self.file, f"no line begins with {names}", "give another file")

    def messages(self, topics: Collection[str]) -> Iterator[Logged]:
        """Yield the messages of some topics in the order of the lines.

        Raises:
            DamagedFileError: If a line is damaged; the message has its number.
        """
        state = _State()
        for number, words in self._lines():
            name = words[0]
            wanted = any(topic.partition("/")[0] == name for topic in topics)
            if name != "PARAM" and not wanted:
                continue
            try:
                found = state.read(words)
            except (ValueError, IndexError, OverflowError) as error:
                reason = f"line {number}: {name}: {error}"
                raise DamagedFileError(self.file, reason, _REMEDY) from error
            yield from (message for message in found if message.topic in topics)

    def close(self) -> None:
        """Do nothing: the file is open only while it is read."""

    def _lines(self) -> Iterator[tuple[int, list[str]]]:
        """Yield number and words of the lines that are not empty or a comment."""
        with self.file.open("rb") as stream:
            number = 0
            while line := stream.readline(_MAX_LINE):
                number += 1
                try:
                    words = line.decode("ascii").split()
                except UnicodeDecodeError as error:
                    reason = f"line {number}: must be plain text"
                    raise DamagedFileError(self.file, reason, _REMEDY) from error
                if len(line) == _MAX_LINE:
                    raise DamagedFileError(self.file, f"line {number}: too long", _REMEDY)
                if words and not words[0].startswith("#"):
                    yield number, words


class _State:
    """Parser of lines that remembers the lines before."""

    def __init__(self) -> None:
        self._offset = {"FLASER": (0.0, 0.0, 0.0), "RLASER": (0.0, 0.0, math.pi)}
        self._received = -math.inf
        self._before: dict[str, tuple[float, _Pose]] = {}

    def read(self, words: Sequence[str]) -> list[Logged]:
        """Return the messages of a line."""
        name, values = words[0], list(words[1:])
        if name == "PARAM":
            self._set_parameter(values)
            return []
        if name == "ODOM":
            return [self._odometry(values)]
        if name.startswith("ROBOTLASER"):
            return self._robot_laser(name, values)
        return self._laser(name, values)

    def _set_parameter(self, values: Sequence[str]) -> None:
        sides = {"robot_frontlaser_offset": ("FLASER", 1.0, 0.0)}
        sides["robot_rearlaser_offset"] = ("RLASER", -1.0, math.pi)
        if len(values) >= 2 and values[0] in sides:
            name, sign, yaw = sides[values[0]]
            self._offset[name] = (sign * _numbers(values[1:2])[0], 0.0, yaw)

    def _odometry(self, values: Sequence[str]) -> LoggedOdometry:
        x, y, yaw, v, w, _ = _numbers(values[:6], 6)
        times = self._times(values[6:])
        return LoggedOdometry("ODOM", *times, "odom", (x, y, _wrapped(yaw)), (v, w))

    def _laser(self, name: str, values: Sequence[str]) -> list[Logged]:
        """Read ``count ranges x y yaw odom_x odom_y odom_yaw time host logger_time``."""
        count = _count(values[0])
        ranges = _ranges(values[1 : 1 + count], count, _RANGE_MAX)
        laser = _pose(values[1 + count : 4 + count])
        driven = _pose(values[4 + count : 7 + count])
        times, mount = self._times(values[7 + count :]), self._offset[name]
        step = _increment(count)
        scan = LoggedScan(
            name, *times, name, ranges, -0.5 * math.pi, step, 0.0, _RANGE_MAX, None, mount
        )
        return [scan, *self._poses(name, times, _without(laser, mount), driven)]

    def _robot_laser(self, name: str, values: Sequence[str]) -> list[Logged]:
        """Read a line with the laser's own angles and limit, and the poses of laser and robot."""
        _, start, _, step, limit, _ = _numbers(values[:6], 6)
        count = _count(values[7])
        ranges = _ranges(values[8 : 8 + count], count, limit)
        rest = values[8 + count :]
        rest = rest[1 + _count(rest[0], 0) :]
        laser, robot = _pose(rest[:3]), _pose(rest[3:6])
        times = self._times(rest[11:])
        mount = tuple(relative_pose(np.array(robot), np.array(laser)).tolist())
        scan = LoggedScan(name, *times, name, ranges, start, step, 0.0, limit, None, mount)
        return [scan, *self._poses(name, times, robot, robot)]

    def _poses(
        self, name: str, times: tuple[float, float], pose: _Pose, driven: _Pose
    ) -> list[Logged]:
        before, self._before[name] = self._before.get(name), (times[1], driven)
        velocity = (0.0, 0.0)
        if before is not None and times[1] - before[0] > _SHORT_S:
            moved = relative_pose(np.array(before[1]), np.array(driven)) / (times[1] - before[0])
            velocity = (float(moved[0]), float(moved[2]))
        return [
            LoggedOdometry(f"{name}/odometry", *times, "odom", driven, velocity),
            LoggedPose(f"{name}/pose", *times, "map", pose),
        ]

    def _times(self, values: Sequence[str]) -> tuple[float, float]:
        """Return when a message was received and its stamp, s, from ``time host logger_time``."""
        (stamp,) = _numbers(values[:1], 1)
        self._received = max(self._received, stamp)
        return self._received, stamp


def _numbers(values: Sequence[str], count: int | None = None) -> list[float]:
    if count is not None and len(values) != count:
        raise ValueError(f"must have {count} numbers here, the line ends after {len(values)}")
    numbers = [float(value) for value in values]
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"must be finite numbers, got {' '.join(values)}")
    return numbers


def _count(value: str, smallest: int = 1) -> int:
    count = int(value)
    if not smallest <= count <= _MAX_BEAMS:
        raise ValueError(f"must have {smallest} to {_MAX_BEAMS:,} readings, got {count}")
    return count


def _ranges(values: Sequence[str], count: int, limit: float) -> np.ndarray:
    if len(values) != count:
        raise ValueError(f"must have {count} readings, the line ends after {len(values)}")
    if not limit > 0.0:
        raise ValueError(f"maximum range must be positive, got {limit:g}")
    ranges = np.array(values, dtype=np.float64)
    return np.where(ranges >= limit, np.inf, ranges)


def _increment(count: int) -> float:
    """Return the angle between beams of a laser without angles, rad: CARMEN's convention.

    180 or 181 readings are 1 degree apart, 360 or 361 half a degree; others span 180 degrees.
    """
    known = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
    return math.radians(known.get(count, 180.0 / max(count - 1, 1)))


def _pose(values: Sequence[str]) -> _Pose:
    x, y, yaw = _numbers(values, 3)
    return x, y, _wrapped(yaw)


def _wrapped(yaw: float) -> float:
    return math.remainder(yaw, math.tau)


def _without(laser: _Pose, mount: _Pose) -> _Pose:
    """Return the robot's pose from that of its laser."""
    yaw = laser[2] - mount[2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y = laser[0] - cos * mount[0] + sin * mount[1], laser[1] - sin * mount[0] - cos * mount[1]
    return x, y, _wrapped(yaw)
