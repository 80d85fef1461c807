"""Inputs of a controller from a log: topics, poses from tf, mount of the lidar."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from navrl.checks import checked_pose
from navrl.deploy.bags.frames import FrameTree
from navrl.deploy.bags.messages import (
    Log,
    Logged,
    LoggedOdometry,
    LoggedPose,
    LoggedScan,
    LoggedTransforms,
)
from navrl.deploy.bags.opening import choose_scans, choose_topic
from navrl.ops.scanner import Scanner

PoseSource = Literal["auto", "pose", "tf", "odometry", "standing"]
POSE_SOURCES = ("auto", "pose", "tf", "odometry", "standing")
_UPSIDE_DOWN = 0.5 * math.pi  # rad of tilt


@dataclass(frozen=True)
class Topics:
    """Topics of a log by their meaning; None for the only one of its kind.

    Args:
        scan: Scans.
        odometry: Odometry.
        pose: Poses of the localization.
        path: Planned paths.
        command: Commands to the base.
        pose_source: ``pose`` topic, ``tf``, ``odometry`` if there is no localization, ``standing``
            for a robot that does not move; ``auto`` for the first that the log has.
        global_frame: Frame of the poses from tf.
        base_frame: Frame of the robot in tf.
    """

    scan: str | None = None
    odometry: str | None = None
    pose: str | None = None
    path: str | None = None
    command: str | None = None
    pose_source: PoseSource = "auto"
    global_frame: str = "map"
    base_frame: str = "base_link"


class LogSource:
    """Messages of a log as inputs of a controller.

    Args:
        log: The log.
        topics: The chosen topics.

    Attributes:
        scan: Name of the topic of scans; ``odometry``, ``pose``, ``path`` and ``command`` are names
            or None.
        pose_source: Source of the poses; never ``auto``.
        tree: Frames of tf at the end of the log.
        base_frame: Frame of the robot: ``base_footprint`` where the log has no other.

    Raises:
        ValueError: If a choice does not fit the log; the message lists what it has.
    """

    def __init__(self, log: Log, topics: Topics) -> None:
        """Choose the topics and read the frames."""
        if topics.pose_source not in POSE_SOURCES:
            raise ValueError(
                f"pose_source={topics.pose_source}: must be one of {', '.join(POSE_SOURCES)}"
            )
        self.log, self.topics = log, topics
        self.scan = choose_scans(log, topics.scan)
        self.odometry = choose_topic(log, "odometry", self._beside(topics.odometry, "odometry"))
        self.pose = choose_topic(log, "pose", self._beside(topics.pose, "pose"))
        self.path = choose_topic(log, "path", topics.path)
        self.command = choose_topic(log, "command", topics.command)
        self._tf = [topic.name for topic in log.topics.values() if topic.kind == "transforms"]
        self.tree = FrameTree()
        for message in log.messages(self._tf):
            if isinstance(message, LoggedTransforms):
                self.tree.update(message)
        self.base_frame = self._base_frame()
        self.pose_source = self._pose_source()

    @property
    def has_tf(self) -> bool:
        """Return whether the log has transforms between any frames."""
        return bool(self._tf)

    def _beside(self, name: str | None, kind: str) -> str | None:
        """Return a topic of CARMEN that comes with the chosen laser, unless one is named."""
        own = f"{self.scan}/{kind}"
        return own if name is None and own in self.log.topics else name

    def _base_frame(self) -> str:
        name, frames = self.topics.base_frame, self.tree.frames
        if name in frames or "base_footprint" not in frames:
            return name
        return "base_footprint"

    def _pose_source(self) -> PoseSource:
        available: dict[PoseSource, bool] = {
            "pose": self.pose is not None,
            "tf": self.tree.lookup(self.topics.global_frame, self.base_frame) is not None,
            "odometry": self.odometry is not None,
            "standing": True,
        }
        wanted = self.topics.pose_source
        if wanted == "auto":
            for name, is_there in available.items():
                if is_there and name != "standing":
                    return name
            raise ValueError(
                f"pose_source=auto: {self.log.file} has neither a pose topic, odometry nor tf from "
                f"{self.topics.global_frame} to {self.base_frame}; for a robot that does not move "
                "use pose_source=standing"
            )
        if not available[wanted]:
            raise ValueError(f"pose_source={wanted}: must be in the log, {self.log.file} has none")
        return wanted

    def messages(self) -> Iterator[Logged]:
        """Yield scans, odometry, poses, paths and commands in the order of their reception.

        A message of tf becomes the pose of the robot, odometry too if it is the source of poses.
        """
        names = [self.scan, self.odometry, self.path, self.command]
        names += [self.pose] if self.pose_source == "pose" else []
        tree = FrameTree()
        for message in self.log.messages({*filter(None, names), *self._tf}):
            if isinstance(message, LoggedTransforms):
                tree.update(message)
                yield from self._poses_of(tree, message)
                continue
            if isinstance(message, LoggedScan) and self.pose_source == "standing":
                yield from self._standing(message)
            yield message
            if isinstance(message, LoggedOdometry) and self.pose_source == "odometry":
                place = (message.topic, message.received, message.stamp, message.frame)
                yield LoggedPose(*place, message.pose)

    def _standing(self, scan: LoggedScan) -> Iterator[Logged]:
        place, here = ("", scan.received, scan.received, ""), (0.0, 0.0, 0.0)
        yield LoggedOdometry(*place, here, (0.0, 0.0))
        yield LoggedPose(*place, here)

    def _poses_of(self, tree: FrameTree, message: LoggedTransforms) -> Iterator[LoggedPose]:
        moving = any(not transform.is_static for transform in message.transforms)
        if self.pose_source != "tf" or not moving:
            return
        found = tree.lookup(self.topics.global_frame, self.base_frame)
        if found is not None:
            stamp = min(found.stamp, message.received)
            frame = self.topics.global_frame
            yield LoggedPose(message.topic, message.received, stamp, frame, found.pose)

    def scanner(
        self, scan: LoggedScan, scanner: Scanner, mount: Sequence[float] | None = None
    ) -> tuple[Scanner, str]:
        """Return the scanner with its mount, and the source of the mount in words.

        Args:
            scan: A scan of the log.
            scanner: Readings of the lidar; its mount if the log has none.
            mount: (x, y, yaw) in the robot frame, m and rad, which has priority; None for the
                log's.
        """
        if mount is not None:
            return replace(
                scanner, mount=tuple(checked_pose("mount", mount).tolist())
            ), "the option mount"
        placed = self.tree.lookup(self.base_frame, scan.frame) if scan.frame else None
        if placed is not None:
            inverted = scanner.is_upside_down or placed.tilt > _UPSIDE_DOWN
            found = replace(scanner, mount=placed.pose, is_upside_down=inverted)
            return found, f"tf {self.base_frame} <- {scan.frame}"
        if scan.mount is not None:
            return replace(scanner, mount=scan.mount), f"the lines of {scan.topic}"
        return scanner, "assumed, the option scanner.mount"

    def first_scan(self) -> LoggedScan:
        """Return the first scan."""
        first = next(iter(self.log.messages([self.scan])))
        assert isinstance(first, LoggedScan)
        return first

    def trajectory(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times of reception ``[T]`` s and poses ``[T, 3]`` of the recorded robot."""
        found = [(m.received, *m.pose) for m in self.messages() if isinstance(m, LoggedPose)]
        rows = np.array(found, dtype=np.float64).reshape(-1, 4)
        rows = rows[np.isfinite(rows).all(axis=1)]
        return rows[:, 0], rows[:, 1:]
