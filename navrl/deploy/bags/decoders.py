"""Messages of ROS 1 and ROS 2 as messages of a log; imports neither."""

from __future__ import annotations

from collections.abc import Callable

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
)
from navrl.deploy.ros_bridge import Message, planar_pose, seconds

_STATIC = "tf_static"


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


DECODERS: dict[str, tuple[Kind, Callable[[Message, str, float], Logged]]] = {
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
"""By message type: what the messages are, and their decoder (message, topic, received)."""
