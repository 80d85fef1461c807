"""ROS 2 node of a policy: ``python -m navrl.deploy.ros2 --ros-args -p policy:=navrl-best``.

It needs the rclpy of the robot's own distribution, sourced before. Parameters and topics are
described in docs/robots.md.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from navrl.deploy.controller import Controller
from navrl.deploy.ros_bridge import (
    Message,
    RosBridge,
    diagnostic_values,
    fill_path,
    fill_twist,
)
from navrl.deploy.ros_markers import attention_spheres, group_arrows
from navrl.deploy.ros_parameters import (
    PARAMETERS,
    checked_parameters,
    make_controller,
    make_planner,
    ready_line,
    unknown_parameters,
)
from navrl.worlds.places.occupancy_map import planar_yaw

_STOP_MESSAGES = 5  # best-effort links lose some
_STOP_PAUSE_S = 0.02
_WAIT_S = 0.1


class PolicyNode:
    """Subscriptions, timer and publishers of a node around a controller.

    Args:
        node: ``rclpy.node.Node``.
    """

    def __init__(self, node: Message) -> None:
        """Declare the parameters and create the topics."""
        from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
        from nav_msgs.msg import Odometry
        from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
        from sensor_msgs.msg import LaserScan
        from std_msgs.msg import Bool

        self.node = node
        self.values = self._declared()
        self.tf = self._transform_buffer() if self._needs_tf() else None
        self.control: Controller | None = None
        self.bridge: RosBridge | None = None
        self._latest: dict[str, Message] = {}  # of path, map and goal, until there is a bridge
        given = tuple(self.values["mount"])
        if not any(map(math.isnan, given)):
            self._build(given)
        self._twist = TwistStamped if self.values["enable_stamped_cmd_vel"] else Twist
        name = self.values["cmd_vel_topic"]
        self.commands = node.create_publisher(self._twist, name, 1)
        self._reports = self._make_reports()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        listen, topic = node.create_subscription, self.values.__getitem__
        sensor = qos_profile_sensor_data
        self._subscriptions = [
            listen(LaserScan, topic("scan_topic"), self._on_scan, sensor),
            listen(Odometry, topic("odom_topic"), self._on_odometry, sensor),
            *self._path_inputs(latched),
            listen(Bool, topic("emergency_stop_topic"), self._on_emergency_stop, 1),
        ]
        if topic("pose_source") == "amcl_pose":
            kind, name = PoseWithCovarianceStamped, topic("pose_topic")
            self._subscriptions.append(listen(kind, name, self._on_pose, latched))
        self._is_stopped = False
        self._timer = node.create_timer(1.0 / topic("controller_frequency"), self.tick)
        self._reporter = node.create_timer(1.0, self._report)

    def _path_inputs(self, latched: Message) -> list[Message]:
        """Subscribe to paths, or to a map and goals; then the paths are published."""
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import OccupancyGrid, Path

        listen, topic = self.node.create_subscription, self.values.__getitem__
        if topic("path_source") == "plan":
            return [listen(Path, topic("plan_topic"), self._storing("on_path"), 1)]
        self._plans = self.node.create_publisher(Path, topic("plan_topic"), latched)
        return [
            listen(OccupancyGrid, topic("map_topic"), self._storing("on_map"), latched),
            listen(PoseStamped, topic("goal_topic"), self._storing("on_goal"), 1),
        ]

    def _declared(self) -> dict[str, Any]:
        from rcl_interfaces.msg import ParameterDescriptor

        free = ParameterDescriptor(dynamic_typing=True)  # an integer may stand for a float
        declare = self.node.declare_parameter
        values = {k: declare(k, v, free).value for k, v in PARAMETERS.items()}
        given = getattr(self.node, "_parameter_overrides", {})  # rclpy has no public name for it
        for line in unknown_parameters({k: each.value for k, each in given.items()}):
            self.node.get_logger().warning(line)
        return checked_parameters(values, ("tf", "amcl_pose", "odometry"))

    def _needs_tf(self) -> bool:
        return self.values["pose_source"] == "tf" or any(map(math.isnan, self.values["mount"]))

    def _transform_buffer(self) -> Message:
        try:
            from tf2_ros import Buffer, TransformListener
        except ImportError as error:
            raise ValueError(
                f"pose_source={self.values['pose_source']}, mount={self.values['mount']}: must be "
                f"amcl_pose or odometry and three numbers, because tf2_ros is absent ({error})"
            ) from error
        buffer = Buffer()
        self._listener = TransformListener(buffer, self.node)
        return buffer

    def _build(self, mount: tuple[float, float, float]) -> None:
        self.control = make_controller(self.values, mount)
        warn = self.node.get_logger().warning
        self.bridge = RosBridge(
            self.control,
            self.values["global_frame"],
            lambda text: warn(text, throttle_duration_sec=1.0),
            make_planner(self.values, self.control, self._publish_path),
        )
        if getattr(self, "_is_stopped", False):
            self.control.emergency_stop()
        for name, message in self._latest.items():
            getattr(self.bridge, name)(message)
        self.node.get_logger().info(ready_line(self.values, mount))

    # --- inputs ----------------------------------------------------------------------------------

    def _on_scan(self, message: Message) -> None:
        if self.bridge is None:
            pose = self._lookup(self.values["robot_base_frame"], message.header.frame_id)
            if pose is None:
                return
            self._build(pose[1])
        assert self.bridge is not None
        self.bridge.on_scan(message)

    def _on_odometry(self, message: Message) -> None:
        if self.bridge is not None:
            self.bridge.on_odometry(message)
            if self.values["pose_source"] == "odometry":
                self.bridge.on_pose(message)

    def _on_pose(self, message: Message) -> None:
        if self.bridge is not None:
            self.bridge.on_pose(message)

    def _storing(self, name: str) -> Callable[[Message], None]:
        """Return a callback that gives a message to the bridge, or stores it until there is one."""

        def receive(message: Message) -> None:
            if self.bridge is None:
                self._latest[name] = message
            else:
                getattr(self.bridge, name)(message)

        return receive

    def _on_emergency_stop(self, message: Message) -> None:
        self._is_stopped = bool(message.data)
        if self.bridge is not None:
            self.bridge.on_emergency_stop(message)
        if self._is_stopped:
            self.send(0.0, 0.0)

    def _lookup(self, target: str, source: str) -> tuple[float, tuple[float, float, float]] | None:
        """Return stamp and pose of the frame ``source`` in ``target``; None if it is not known."""
        from rclpy.time import Time

        assert self.tf is not None
        try:
            found = self.tf.lookup_transform(target, source, Time())
        except Exception as error:  # tf2 has one class for each reason
            text = f"tf {target} <- {source}: {error}"
            self.node.get_logger().warning(text, throttle_duration_sec=1.0)
            return None
        place, turn = found.transform.translation, found.transform.rotation
        stamp = found.header.stamp
        return stamp.sec + 1e-9 * stamp.nanosec, (place.x, place.y, planar_yaw(turn))

    # --- outputs ---------------------------------------------------------------------------------

    def tick(self) -> None:
        """Decide and publish the command; zero until the mount of the lidar is known."""
        if self.control is None:
            self.send(0.0, 0.0)
            return
        if self.values["pose_source"] == "tf":
            found = self._lookup(self.values["global_frame"], self.values["robot_base_frame"])
            if found is not None:
                try:
                    self.control.on_pose(*found)
                except ValueError as error:
                    self.node.get_logger().warning(f"tf: {error}", throttle_duration_sec=1.0)
        v, w, _ = self.control.tick(self.node.get_clock().now().nanoseconds * 1e-9)
        self.send(v, w)
        if self.bridge is not None and self.bridge.planner is not None:
            self.bridge.planner.poll()  # after the command, so that zero is out before it plans
        self._mark()

    def send(self, v: float, w: float) -> None:
        """Publish a command, m/s and rad/s; nothing in a dry run."""
        if self.values["dry_run"]:
            return
        stamp, frame = self.node.get_clock().now().to_msg(), self.values["robot_base_frame"]
        self.commands.publish(fill_twist(self._twist(), v, w, stamp, frame))

    def _publish_path(self, path: np.ndarray) -> None:
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Path

        stamp, frame = self.node.get_clock().now().to_msg(), self.values["global_frame"]
        self._plans.publish(fill_path(Path(), PoseStamped, path, stamp, frame))

    def stop(self) -> None:
        """Publish zero several times, before the node ends."""
        for _ in range(_STOP_MESSAGES):
            self.send(0.0, 0.0)
            time.sleep(_STOP_PAUSE_S)

    def _make_reports(self) -> dict[str, Any]:
        from diagnostic_msgs.msg import DiagnosticArray

        reports = {"diagnostics": self.node.create_publisher(DiagnosticArray, "/diagnostics", 1)}
        if self.values["publish_markers"]:
            from visualization_msgs.msg import MarkerArray

            reports["markers"] = self.node.create_publisher(MarkerArray, "~/markers", 1)
        return reports

    def _report(self) -> None:
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        status = self.control.status if self.control is not None else None
        if status is None:
            return
        planner = self.bridge.planner if self.bridge is not None else None
        level, text, values = diagnostic_values(status, planner)
        entry = DiagnosticStatus(level=bytes([level]), name=self.node.get_name(), message=text)
        entry.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        message = DiagnosticArray(status=[entry])
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._reports["diagnostics"].publish(message)

    def _mark(self) -> None:
        status = self.control.status if self.control is not None else None
        publisher = self._reports.get("markers")
        if status is None or publisher is None or publisher.get_subscription_count() == 0:
            return
        from geometry_msgs.msg import Point
        from visualization_msgs.msg import Marker, MarkerArray

        stamp, frame = self.node.get_clock().now().to_msg(), self.values["robot_base_frame"]
        shapes = (*attention_spheres(status), *group_arrows(status))
        markers = [Marker(action=Marker.DELETEALL)]
        for index, shape in enumerate(shapes):
            marker = Marker(id=index, ns=shape.kind, type=shape.code)
            marker.header.frame_id, marker.header.stamp = frame, stamp
            marker.pose.orientation.w = 1.0
            marker.scale.x, marker.scale.y, marker.scale.z = shape.size
            marker.color.r, marker.color.g, marker.color.b, marker.color.a = shape.color
            marker.points = [Point(x=float(x), y=float(y)) for x, y in shape.points]
            markers.append(marker)
        publisher.publish(MarkerArray(markers=markers))


def _end_if(stopping: threading.Event) -> None:
    if stopping.is_set():
        raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; zero is published at the end, also of an exception."""
    import rclpy
    from rclpy.clock import Clock, ClockType  # pyright: ignore[reportPrivateImportUsage] -- Humble
    from rclpy.signals import SignalHandlerOptions

    # rclpy's own handler shuts the context down before the last zero could be published
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    stopping = threading.Event()  # an exception of the handler could be ignored where it is raised
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    node = rclpy.create_node("navrl")
    policy = None
    try:
        policy = PolicyNode(node)
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # runs while /clock rests, too
        node.create_timer(_WAIT_S, lambda: _end_if(stopping), clock=steady)
        rclpy.spin(node)
    except KeyboardInterrupt:
        return 0
    except ValueError as error:
        node.get_logger().fatal(str(error))
        return 2
    finally:
        if policy is not None:
            policy.stop()
        node.destroy_node()
        rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
