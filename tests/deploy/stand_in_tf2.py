"""A stand-in for tf2_ros, which PyPI does not have: topics of TransformStamped."""

from types import ModuleType

import numpy as np

from navrl.deploy.bags import FrameTransform, FrameTree, homogeneous

TOPICS = ("tf", "tf_static")


class LookupException(Exception):
    """The frames are not connected."""


class Buffer:
    """Latest transforms."""

    def __init__(self):
        self.tree = FrameTree()

    def add(self, message, is_static):
        place, turn = message.transform.translation, message.transform.rotation
        matrix = homogeneous((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        names = message.header.frame_id, message.child_frame_id
        self.tree.add(FrameTransform(*names, stamp, matrix, is_static))

    def lookup_transform(self, target, source, time):
        from geometry_msgs.msg import TransformStamped

        assert time.nanoseconds == 0  # the latest
        placed = self.tree.lookup(target, source)
        if placed is None:
            raise LookupException(f'"{source}" is not connected to "{target}"')
        message = TransformStamped()
        message.header.frame_id, message.child_frame_id = target, source
        stamp = placed.stamp if np.isfinite(placed.stamp) else 0.0
        message.header.stamp.sec, part = int(stamp), stamp % 1.0
        message.header.stamp.nanosec = int(part * 1e9)
        x, y, yaw = placed.pose
        message.transform.translation.x, message.transform.translation.y = x, y
        turn = message.transform.rotation
        turn.z, turn.w = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
        return message


class TransformListener:
    """Subscriptions that fill a buffer."""

    def __init__(self, buffer, node):
        from geometry_msgs.msg import TransformStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile

        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, qos in zip(TOPICS, (10, latched), strict=True):
            node.create_subscription(
                TransformStamped,
                topic,
                lambda message, is_static=topic == "tf_static": buffer.add(message, is_static),
                qos,
            )


def module():
    """Return the module ``tf2_ros``."""
    found = ModuleType("tf2_ros")
    found.Buffer, found.TransformListener = Buffer, TransformListener
    return found
