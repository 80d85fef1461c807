"""Messages of ROS 1 and ROS 2 as inputs of a controller; imports neither.

Messages are read by their fields, which both versions share, so this module needs no ROS.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from navrl.deploy.control_status import ControlStatus
from navrl.deploy.controller import Controller
from navrl.deploy.map_planner import MapPlanner
from navrl.deploy.safety import DriveState
from navrl.worlds.places.occupancy_map import Message, planar_yaw


def fill_twist(message: Message, v: float, w: float, stamp: Message, frame: str) -> Message:
    """Write a command, m/s and rad/s, into a Twist or TwistStamped, and return it."""
    twist = message.twist if hasattr(message, "twist") else message
    twist.linear.x, twist.angular.z = float(v), float(w)
    if twist is not message:
        message.header.stamp, message.header.frame_id = stamp, frame
    return message


class RosBridge:
    """Callbacks of a node: read a message and give it to the controller.

    A message that is refused is reported by ``warn`` and stops the robot.

    Args:
        control: The controller.
        global_frame: Frame of paths, poses, goals and the map.
        warn: Called with one line.
        planner: Planner for goals on the map; ``None`` for paths of others.
    """

    def __init__(
        self,
        control: Controller,
        global_frame: str,
        warn: Callable[[str], object],
        planner: MapPlanner | None = None,
    ) -> None:
        """Store the arguments."""
        self.control, self.global_frame, self.warn = control, global_frame, warn
        self.planner = planner

    def on_scan(self, message: Message) -> None:
        """Read a sensor_msgs/LaserScan."""
        count = len(message.ranges)
        duration = message.time_increment * (count - 1)
        self._give(
            "scan",
            self.control.on_scan,
            seconds(message.header.stamp),
            np.asarray(message.ranges, dtype=np.float64),
            message.angle_min,
            message.angle_increment,
            message.range_min,
            message.range_max,
            duration if duration > 0.0 else None,
        )

    def on_odometry(self, message: Message) -> None:
        """Read a nav_msgs/Odometry."""
        twist = message.twist.twist
        velocity = (twist.linear.x, twist.angular.z)
        pose = planar_pose(message.pose.pose)
        stamp = seconds(message.header.stamp)
        self._give("odometry", self.control.on_odometry, stamp, pose, velocity)

    def on_pose(self, message: Message) -> None:
        """Read a geometry_msgs/PoseWithCovarianceStamped or a nav_msgs/Odometry as the pose."""
        pose = planar_pose(message.pose.pose)
        self._give("pose", self.control.on_pose, seconds(message.header.stamp), pose)

    def on_path(self, message: Message) -> None:
        """Read a nav_msgs/Path; an empty one cancels the drive."""
        if problem := self._wrong_frame("path", message):
            self.control.on_path(None)
            self.warn(problem)
            return
        points = [(each.pose.position.x, each.pose.position.y) for each in message.poses]
        self._give("path", self.control.on_path, points or None)

    def on_map(self, message: Message) -> None:
        """Read a nav_msgs/OccupancyGrid; it is used from the next goal on."""
        problem = self._wrong_frame("map", message)
        if problem:
            self.warn(problem)
        elif self.planner is not None:
            self.planner.set_map(message)

    def on_goal(self, message: Message) -> None:
        """Read a geometry_msgs/PoseStamped; its orientation is ignored."""
        if self.planner is None:
            return
        place, problem = message.pose.position, self._wrong_frame("goal", message)
        if problem:
            self.planner.refuse(problem)
            self.warn(problem)
        else:
            self.planner.set_goal((place.x, place.y))

    def _wrong_frame(self, name: str, message: Message) -> str:
        """Return the error for a message of another frame; empty for one of the global frame."""
        frame = message.header.frame_id
        if frame == self.global_frame:
            return ""
        return f"{name}: frame_id={frame!r}: must be the global_frame {self.global_frame!r}"

    def on_emergency_stop(self, message: Message) -> None:
        """Read a std_msgs/Bool: true stops, false releases."""
        if message.data:
            self.control.emergency_stop()
        else:
            self.control.release()

    def _give(self, name: str, method: Callable[..., None], *values: Any) -> None:
        try:
            method(*values)
        except ValueError as error:
            self.warn(f"{name}: {error}")


def seconds(stamp: Message) -> float:
    """Return a time of ROS 1 or ROS 2 in seconds."""
    return stamp.to_sec() if hasattr(stamp, "to_sec") else stamp.sec + 1e-9 * stamp.nanosec


def planar_pose(pose: Message) -> tuple[float, float, float]:
    """Return a geometry_msgs/Pose as (x, y, yaw), m and rad; NaN for an invalid orientation."""
    return (pose.position.x, pose.position.y, planar_yaw(pose.orientation))


def fill_path(
    message: Message, make_pose: Callable[[], Message], path: np.ndarray, stamp: Message, frame: str
) -> Message:
    """Fill an empty nav_msgs/Path with a path, and return the message.

    Args:
        message: The empty nav_msgs/Path.
        make_pose: The class geometry_msgs/PoseStamped.
        path: ``[P, 2]`` m.
        stamp: Time stamp of the path.
        frame: Name of the frame of its points.
    """
    message.header.stamp, message.header.frame_id = stamp, frame
    message.poses = [make_pose() for _ in path]
    for pose, (x, y) in zip(message.poses, path.tolist(), strict=True):
        pose.header = message.header
        pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = x, y, 1.0
    return message


def diagnostic_values(
    status: ControlStatus, planner: MapPlanner | None = None
) -> tuple[int, str, dict[str, str]]:
    """Return level (0 OK, 1 warning, 2 error), message and values of a diagnostic status.

    Without a path, the message is the planner's reason, and a refused goal an error.
    """
    state = status.state
    idle = (DriveState.DRIVE, DriveState.AT_GOAL, DriveState.NO_PATH)
    failed = (DriveState.BAD_COMMAND, DriveState.BLIND, DriveState.STALE_SCAN)
    level = 0 if state in idle else 2 if state in failed else 1
    fields = ("scan_age_s", "pose_age_s", "progress_m", "goal_distance_m", "icp_converged")
    counts = ("icp_inliers", "num_steps", "num_thinned", "num_rejected", "num_resets")
    values = {name: str(getattr(status, name)) for name in (*fields, *counts)}
    values |= {"v": f"{status.command.v:.3f}", "w": f"{status.command.w:.3f}"}
    reason = status.reason
    if planner is not None and state is DriveState.NO_PATH and planner.reason:
        level, reason = 2 if planner.is_refused else 0, planner.reason
    return level, f"{state}: {reason}" if reason else str(state), values
