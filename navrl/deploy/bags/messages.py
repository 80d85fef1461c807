"""Messages of a log in numpy, the same for all formats."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

Kind = Literal["scan", "odometry", "pose", "path", "command", "transforms"]
"""What the messages of a topic are."""


@dataclass(frozen=True)
class Topic:
    """Topic of a log.

    Args:
        name: Its name, with a leading slash in bags.
        kind: What its messages are; None for types that are not read.
        type_name: Message type, e.g. ``sensor_msgs/msg/LaserScan``.
        count: Number of messages.
        reliability: ``"reliable"`` or ``"best_effort"`` as the publisher offered it; None if the
            log does not have it.
        durability: ``"volatile"`` or ``"transient_local"``, likewise.
    """

    name: str
    kind: Kind | None
    type_name: str
    count: int
    reliability: str | None = None
    durability: str | None = None


@dataclass(frozen=True, eq=False)
class Logged:
    """Fields that all messages have.

    Args:
        topic: Name of the topic.
        received: Time at which the message was recorded, s.
        stamp: Time of the measurement, s; ``received`` for messages without a header.
        frame: Frame of the values; empty if unknown.
    """

    topic: str
    received: float
    stamp: float
    frame: str


@dataclass(frozen=True, eq=False)
class LoggedScan(Logged):
    """Scan of a planar lidar.

    Args:
        ranges: ``[M]`` float64 m; M may change from scan to scan.
        angle_min: Angle of beam 0, rad, in the lidar's frame.
        angle_increment: Angle from beam to beam, rad.
        range_min: Smallest distance, m.
        range_max: Largest distance, m.
        duration_s: Time from the first to the last beam, s; None if unknown.
        mount: ``[3]`` (x, y, yaw) of the lidar in the robot frame, m and rad, if the log has it.
    """

    ranges: np.ndarray
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    duration_s: float | None = None
    mount: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class LoggedOdometry(Logged):
    """Odometry.

    Args:
        pose: ``[3]`` (x, y, yaw), m and rad.
        velocity: (v, w), m/s and rad/s.
    """

    pose: tuple[float, float, float]
    velocity: tuple[float, float]


@dataclass(frozen=True, eq=False)
class LoggedPose(Logged):
    """Pose of the robot by localization.

    Args:
        pose: ``[3]`` (x, y, yaw), m and rad.
    """

    pose: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class LoggedPath(Logged):
    """Planned path.

    Args:
        points: ``[P, 2]`` float64 m; without points if the drive was canceled.
    """

    points: np.ndarray


@dataclass(frozen=True, eq=False)
class LoggedCommand(Logged):
    """Command to the base.

    Args:
        command: (v, w), m/s and rad/s.
    """

    command: tuple[float, float]


@dataclass(frozen=True, eq=False)
class FrameTransform:
    """Pose of a frame in another.

    Args:
        parent: Frame of the pose.
        child: Frame that has this pose.
        stamp: Time, s.
        matrix: ``[4, 4]`` homogeneous, m.
        is_static: Whether it holds at any time.
    """

    parent: str
    child: str
    stamp: float
    matrix: np.ndarray
    is_static: bool


@dataclass(frozen=True, eq=False)
class LoggedTransforms(Logged):
    """Message of tf.

    Args:
        transforms: Its transforms.
    """

    transforms: tuple[FrameTransform, ...]


class Log(Protocol):
    """Log of a robot, which can be read several times."""

    file: Path
    """File or folder."""
    topics: dict[str, Topic]
    """Topics by name."""

    def messages(self, topics: Collection[str]) -> Iterator[Logged]:
        """Yield the messages of some topics in the order in which they were recorded.

        Raises:
            DamagedFileError: If a message is damaged; one line with file and place.
        """
        ...

    def close(self) -> None:
        """Close the file."""
        ...
