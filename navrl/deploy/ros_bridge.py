"""Messages of ROS 1 and ROS 2 as inputs of a controller; imports neither.

Messages are read by their fields, which both versions share, so this module needs no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from navrl.deploy.control_limits import ControlLimits
from navrl.deploy.control_status import ControlStatus
from navrl.deploy.controller import Controller
from navrl.deploy.safety import DriveState, SafetyLimits
from navrl.deploy.scan_adapter import load_scanner
from navrl.policies.names import bundle_folder

Message: TypeAlias = Any
"""A message of ROS 1 or ROS 2, or a field of one."""

PARAMETERS: dict[str, Any] = {
    "policy": "navrl-best",
    "scanner": "any",
    "mount": [math.nan, math.nan, math.nan],
    "is_upside_down": False,
    "own_radius": 0.0,
    "blind_sectors": [0.0, 0.0],
    "global_frame": "map",
    "robot_base_frame": "base_link",
    "pose_source": "tf",
    "scan_topic": "scan",
    "odom_topic": "odom",
    "pose_topic": "amcl_pose",
    "plan_topic": "plan",
    "cmd_vel_topic": "cmd_vel",
    "emergency_stop_topic": "emergency_stop",
    "enable_stamped_cmd_vel": False,
    "controller_frequency": 20.0,
    "transform_tolerance": 0.1,
    "scan_timeout": 0.5,
    "pose_timeout": 0.5,
    "xy_goal_tolerance": 0.2,
    "max_path_distance": 2.0,
    "min_measured_share": 0.01,
    "speed_scale": 1.0,
    "max_vel_x": math.inf,
    "min_vel_x": -math.inf,
    "max_vel_theta": math.inf,
    "acc_lim_x": math.inf,
    "decel_lim_x": -math.inf,
    "acc_lim_theta": math.inf,
    "compensate_motion": True,
    "publish_markers": True,
    "dry_run": False,
}
"""Parameters of both nodes with their defaults; docs/robots.md describes them."""


_MIN_FREQUENCY_HZ = 10.0  # so that the robot stops within 0.1 s


def check_parameters(parameters: dict[str, Any], sources: tuple[str, ...]) -> None:
    """Check the source of the pose and the frequency.

    Args:
        parameters: Values of :data:`PARAMETERS`.
        sources: Values of ``pose_source`` that the node has.

    Raises:
        ValueError: If a parameter is not allowed; the message names it.
    """
    source, frequency = parameters["pose_source"], parameters["controller_frequency"]
    if source not in sources:
        raise ValueError(f"pose_source={source}: must be one of {', '.join(sources)}")
    if not frequency >= _MIN_FREQUENCY_HZ:
        raise ValueError(
            f"controller_frequency={frequency}: must be at least {_MIN_FREQUENCY_HZ:g} Hz, so that "
            "the robot stops within 0.1 s"
        )


def fill_twist(message: Message, v: float, w: float, stamp: Message, frame: str) -> Message:
    """Write a command, m/s and rad/s, into a Twist or TwistStamped, and return it."""
    twist = message.twist if hasattr(message, "twist") else message
    twist.linear.x, twist.angular.z = float(v), float(w)
    if twist is not message:
        message.header.stamp, message.header.frame_id = stamp, frame
    return message


def make_controller(parameters: dict[str, Any], mount: tuple[float, float, float]) -> Controller:
    """Return the controller of a node, warmed up.

    Args:
        parameters: Values of :data:`PARAMETERS`.
        mount: (x, y, yaw) of the lidar in the robot frame, m and rad.

    Raises:
        ValueError: If a parameter is out of range; the message names it.
    """
    folder = bundle_folder(parameters["policy"])
    if folder is None:
        raise ValueError(f"policy={parameters['policy']}: must be a bundle or a name of the zoo")
    sectors = np.asarray(parameters["blind_sectors"], dtype=np.float64)
    if len(sectors) % 2:
        raise ValueError(f"blind_sectors={sectors.tolist()}: must be pairs of bearing and width")
    scanner = load_scanner(
        parameters["scanner"],
        mount=mount,
        is_upside_down=bool(parameters["is_upside_down"]),
        own_radius=float(parameters["own_radius"]),
        blind_sectors=[pair for pair in sectors.reshape(-1, 2).tolist() if pair[1] > 0.0],
    )
    limits = ControlLimits(
        scan_timeout_s=parameters["scan_timeout"],
        pose_timeout_s=parameters["pose_timeout"],
        max_clock_skew_s=parameters["transform_tolerance"],
        speed_scale=parameters["speed_scale"],
        max_speed=parameters["max_vel_x"],
        max_reverse_speed=abs(parameters["min_vel_x"]) or 1e-9,
        max_turn_rate=parameters["max_vel_theta"],
        linear_acceleration=parameters["acc_lim_x"],
        linear_deceleration=abs(parameters["decel_lim_x"]),
        angular_acceleration=parameters["acc_lim_theta"],
    )
    safety = SafetyLimits(
        goal_radius=parameters["xy_goal_tolerance"],
        max_path_distance=parameters["max_path_distance"],
        min_measured_share=parameters["min_measured_share"],
    )
    control = Controller.from_bundle(
        folder,
        scanner,
        limits,
        parameters["compensate_motion"],
        safety=safety,
        with_attention=has_attention(folder),
    )
    control.warm_up()
    return control


class RosBridge:
    """Callbacks of a node: read a message and give it to the controller.

    A message that is refused is reported by ``warn`` and stops the robot.

    Args:
        control: The controller.
        global_frame: Frame of paths and poses.
        warn: Called with one line.
    """

    def __init__(
        self, control: Controller, global_frame: str, warn: Callable[[str], object]
    ) -> None:
        """Store the arguments."""
        self.control, self.global_frame, self.warn = control, global_frame, warn

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
        frame = message.header.frame_id
        if frame != self.global_frame:
            self.control.on_path(None)
            self.warn(f"path: frame_id={frame!r}: must be the global_frame {self.global_frame!r}")
            return
        points = [(each.pose.position.x, each.pose.position.y) for each in message.poses]
        self._give("path", self.control.on_path, points or None)

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


def has_attention(folder: Path) -> bool:
    """Return whether the actor of a bundle can write attention weights."""
    from navrl.policies import load_bundle

    try:
        load_bundle(folder).actor_with_attention()
    except (TypeError, ValueError, RuntimeError):
        return False
    return True


def seconds(stamp: Message) -> float:
    """Return a time of ROS 1 or ROS 2 in seconds."""
    return stamp.to_sec() if hasattr(stamp, "to_sec") else stamp.sec + 1e-9 * stamp.nanosec


def planar_pose(pose: Message) -> tuple[float, float, float]:
    """Return a geometry_msgs/Pose as (x, y, yaw), m and rad; NaN for an invalid orientation."""
    return (pose.position.x, pose.position.y, planar_yaw(pose.orientation))


def planar_yaw(q: Message) -> float:
    """Return the yaw of a quaternion, rad; NaN for one that is not of unit length."""
    length = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if not abs(length - 1.0) < 0.01:
        return math.nan
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def diagnostic_values(status: ControlStatus) -> tuple[int, str, dict[str, str]]:
    """Return level (0 OK, 1 warning, 2 error), message and values of a diagnostic status."""
    state = status.state
    idle = (DriveState.DRIVE, DriveState.AT_GOAL, DriveState.NO_PATH)
    failed = (DriveState.BAD_COMMAND, DriveState.BLIND, DriveState.STALE_SCAN)
    level = 0 if state in idle else 2 if state in failed else 1
    fields = ("scan_age_s", "pose_age_s", "progress_m", "goal_distance_m", "icp_converged")
    counts = ("icp_inliers", "num_steps", "num_thinned", "num_rejected", "num_resets")
    values = {name: str(getattr(status, name)) for name in (*fields, *counts)}
    values |= {"v": f"{status.command.v:.3f}", "w": f"{status.command.w:.3f}"}
    return level, f"{state}: {status.reason}" if status.reason else str(state), values
