"""Bags of ROS 1 and ROS 2, read by rosbags without ROS."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import numpy as np

from navrl.deploy.bags.frames import homogeneous
from navrl.deploy.bags.messages import (
    FrameTransform,
    Kind,
    Logged,
    LoggedCommand,
    LoggedOdometry,
    LoggedPath,
    LoggedPose,
    LoggedScan,
    LoggedTransforms,
    Topic,
)
from navrl.deploy.ros_bridge import Message, planar_pose, seconds
from navrl.extras import require
from navrl.untrusted import DamagedFileError

_REMEDY = "rosbag reindex (ROS 1), ros2 bag reindex or mcap recover (ROS 2) may repair it"
_NANOSECONDS = 1e9  # of a second
_STATIC = "tf_static"
_MAX_REASON = 150  # characters; rosbags quotes a whole definition


class RosLog:
    """Bag of ROS 1, or of ROS 2 as SQLite or MCAP.

    Args:
        file: ``.bag``, ``.db3`` or ``.mcap`` file, or the folder of a ROS 2 bag.

    Raises:
        ModuleNotFoundError: If the extra ``bags`` is not installed.
        DamagedFileError: If the bag cannot be read.
    """

    def __init__(self, file: str | Path) -> None:
        """Open the bag and list its topics."""
        require("bags", "a bag", "rosbags")
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.file = Path(file)
        # Bags of Humble and before have no definitions; the messages read here did not change.
        known = get_typestore(Stores.ROS2_HUMBLE)
        try:
            self._reader = AnyReader([self.file], default_typestore=known)
            self._reader.open()
            self.topics = {name: _topic(name, info) for name, info in self._reader.topics.items()}
        except Exception as error:  # rosbags passes on errors of struct, apsw, lz4, ...
            raise DamagedFileError(
                self.file, f"damaged or not a bag ({_reason(error)})", _REMEDY
            ) from error

    def messages(self, topics: Collection[str]) -> Iterator[Logged]:
        """Yield the messages of some topics in the order of their reception.

        Raises:
            DamagedFileError: If a message is damaged; one line with file and place.
        """
        chosen = [each for each in self._reader.connections if each.topic in topics]
        if not chosen:
            return
        rows, place = self._reader.messages(chosen), "first message"
        while True:
            try:
                row = next(rows, None)
                if row is None:
                    return
                connection, time, data = row
                place = f"{connection.topic}, message at {time / _NANOSECONDS:.3f} s"
                message = self._reader.deserialize(data, connection.msgtype)
                decoded = _DECODERS[connection.msgtype][1](
                    message, connection.topic, time / _NANOSECONDS
                )
            except Exception as error:
                raise DamagedFileError(
                    self.file, f"{place}: damaged ({_reason(error)})", _REMEDY
                ) from error
            place = f"after {place}"
            yield decoded

    def close(self) -> None:
        """Close the bag."""
        self._reader.close()


def _topic(name: str, info: Message) -> Topic:
    kind = _DECODERS.get(info.msgtype, (None, None))[0]
    policies = [
        profile
        for connection in info.connections
        for profile in getattr(connection.ext, "offered_qos_profiles", ())
    ]
    first = policies[0] if policies else None
    latched = any(getattr(connection.ext, "latching", None) for connection in info.connections)
    return Topic(
        name,
        kind,
        info.msgtype or "several types",
        info.msgcount,
        first and first.reliability.name.lower(),
        first.durability.name.lower() if first else "transient_local" if latched else None,
    )


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text.rstrip(".")[:_MAX_REASON]


# --- decoders ------------------------------------------------------------------------------------


def _header(message: Message, topic: str, received: float) -> tuple[str, float, float, str]:
    return topic, received, seconds(message.header.stamp), message.header.frame_id.lstrip("/")


def _scan(message: Message, topic: str, received: float) -> LoggedScan:
    duration = message.time_increment * (len(message.ranges) - 1)
    return LoggedScan(
        *_header(message, topic, received),
        np.asarray(message.ranges, dtype=np.float64),
        float(message.angle_min),
        float(message.angle_increment),
        float(message.range_min),
        float(message.range_max),
        float(duration) if duration > 0.0 else None,
    )


def _odometry(message: Message, topic: str, received: float) -> LoggedOdometry:
    twist = message.twist.twist
    pose = planar_pose(message.pose.pose)
    velocity = (float(twist.linear.x), float(twist.angular.z))
    return LoggedOdometry(*_header(message, topic, received), pose, velocity)


def _pose(message: Message, topic: str, received: float) -> LoggedPose:
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    return LoggedPose(*_header(message, topic, received), planar_pose(pose))


def _path(message: Message, topic: str, received: float) -> LoggedPath:
    points = [(each.pose.position.x, each.pose.position.y) for each in message.poses]
    array = np.array(points, dtype=np.float64).reshape(-1, 2)
    return LoggedPath(*_header(message, topic, received), array)


def _twist(message: Message, topic: str, received: float) -> LoggedCommand:
    command = (float(message.linear.x), float(message.angular.z))
    return LoggedCommand(topic, received, received, "", command)


def _stamped_twist(message: Message, topic: str, received: float) -> LoggedCommand:
    command = (float(message.twist.linear.x), float(message.twist.angular.z))
    return LoggedCommand(*_header(message, topic, received), command)


def _transforms(message: Message, topic: str, received: float) -> LoggedTransforms:
    found = []
    for each in message.transforms:
        place, turn = each.transform.translation, each.transform.rotation
        matrix = homogeneous((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
        parent, child = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
        stamp, is_static = seconds(each.header.stamp), topic.endswith(_STATIC)
        found.append(FrameTransform(parent, child, stamp, matrix, is_static))
    return LoggedTransforms(topic, received, received, "", tuple(found))


_DECODERS: dict[str, tuple[Kind, Callable[[Message, str, float], Logged]]] = {
    "sensor_msgs/msg/LaserScan": ("scan", _scan),
    "nav_msgs/msg/Odometry": ("odometry", _odometry),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose", _pose),
    "geometry_msgs/msg/PoseStamped": ("pose", _pose),
    "nav_msgs/msg/Path": ("path", _path),
    "geometry_msgs/msg/Twist": ("command", _twist),
    "geometry_msgs/msg/TwistStamped": ("command", _stamped_twist),
    "tf2_msgs/msg/TFMessage": ("transforms", _transforms),
    "tf/msg/tfMessage": ("transforms", _transforms),
}
