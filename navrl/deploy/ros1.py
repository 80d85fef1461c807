"""ROS 1 node of a policy: ``python -m navrl.deploy.ros1 _policy:=navrl-best``.

It needs rospy, of a distribution of ROS 1 or of Debian (``python3-rospy``). Parameters and topics
are those of the ROS 2 node, docs/robots.md.
"""

from __future__ import annotations

import math
import sys
import threading
import time

import numpy as np

from navrl.deploy.ros_bridge import (
    Message,
    RosBridge,
    diagnostic_values,
    fill_path,
    fill_twist,
)
from navrl.deploy.ros_parameters import (
    PARAMETERS,
    checked_parameters,
    make_controller,
    make_planner,
    ready_line,
    unknown_parameters,
)

_STOP_MESSAGES, _STOP_PAUSE_S = 5, 0.02
_DEFAULTS = {**PARAMETERS, "goal_topic": "move_base_simple/goal"}  # that of RViz of ROS 1


class PolicyNode:
    """Subscriptions and publishers around a controller.

    Callbacks of rospy run in threads of their own, as the controller allows; commands are sent by
    the thread of :meth:`spin` only.

    Args:
        rospy: The module, after ``init_node``.
    """

    def __init__(self, rospy: Message) -> None:
        """Read the parameters and create the topics."""
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import LaserScan
        from std_msgs.msg import Bool

        self.rospy = rospy
        values = {k: rospy.get_param(f"~{k}", v) for k, v in _DEFAULTS.items()}
        for line in unknown_parameters(rospy.get_param("~", {})):
            rospy.logwarn(line)
        self.values = checked_parameters(values, ("amcl_pose", "odometry"))
        source, mount = self.values["pose_source"], tuple(self.values["mount"])
        if any(map(math.isnan, mount)):
            raise ValueError("mount: must be three numbers (x, y, yaw) in ROS 1")
        self.control = make_controller(self.values, mount)
        self.bridge = RosBridge(
            self.control,
            self.values["global_frame"],
            lambda text: rospy.logwarn_throttle(1.0, text),
            make_planner(self.values, self.control, self._publish_path),
        )
        self._twist = TwistStamped if self.values["enable_stamped_cmd_vel"] else Twist
        name = self.values["cmd_vel_topic"]
        self.commands = rospy.Publisher(name, self._twist, queue_size=1)
        self.reports = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)
        bridge, topic = self.bridge, self.values.__getitem__
        listen = rospy.Subscriber
        listen(topic("scan_topic"), LaserScan, bridge.on_scan, queue_size=1)
        listen(topic("odom_topic"), Odometry, self._on_odometry, queue_size=10)
        self._listen_for_paths()
        listen(topic("emergency_stop_topic"), Bool, bridge.on_emergency_stop, queue_size=1)
        if source == "amcl_pose":
            kind = PoseWithCovarianceStamped
            listen(topic("pose_topic"), kind, bridge.on_pose, queue_size=1)
        rospy.loginfo(ready_line(self.values, mount))

    def _listen_for_paths(self) -> None:
        """Subscribe to paths, or to a map and goals; then the paths are published."""
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import OccupancyGrid, Path

        listen, topic, bridge = self.rospy.Subscriber, self.values.__getitem__, self.bridge
        if topic("path_source") == "plan":
            listen(topic("plan_topic"), Path, bridge.on_path, queue_size=1)
            return
        self._plans = self.rospy.Publisher(topic("plan_topic"), Path, queue_size=1, latch=True)
        listen(topic("map_topic"), OccupancyGrid, bridge.on_map, queue_size=1)
        listen(topic("goal_topic"), PoseStamped, bridge.on_goal, queue_size=1)

    def _publish_path(self, path: np.ndarray) -> None:
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Path

        stamp, frame = self.rospy.Time.now(), self.values["global_frame"]
        self._plans.publish(fill_path(Path(), PoseStamped, path, stamp, frame))

    def _on_odometry(self, message: Message) -> None:
        self.bridge.on_odometry(message)
        if self.values["pose_source"] == "odometry":
            self.bridge.on_pose(message)

    def spin(self, stopping: threading.Event) -> None:
        """Tick at the controller's frequency until ``stopping`` is set; zero is published last."""
        period, count = 1.0 / self.values["controller_frequency"], 0
        try:
            while not stopping.wait(period):
                v, w, _ = self.control.tick(self.rospy.get_time())
                self.send(v, w)
                if self.bridge.planner is not None:
                    self.bridge.planner.poll()  # after the command: zero is out before it plans
                count += 1
                if count % max(1, round(1.0 / period)) == 0:
                    self.report()
        finally:
            for _ in range(_STOP_MESSAGES):
                self.send(0.0, 0.0)
                time.sleep(_STOP_PAUSE_S)

    def send(self, v: float, w: float) -> None:
        """Publish a command, m/s and rad/s; nothing in a dry run."""
        if self.values["dry_run"]:
            return
        stamp, frame = self.rospy.Time.now(), self.values["robot_base_frame"]
        self.commands.publish(fill_twist(self._twist(), v, w, stamp, frame))

    def report(self) -> None:
        """Publish the diagnostics."""
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        if self.control.status is None:
            return
        level, text, values = diagnostic_values(self.control.status, self.bridge.planner)
        entry = DiagnosticStatus(level=level, name="navrl", message=text)
        entry.values = [KeyValue(key=key, value=value) for key, value in values.items()]
        message = DiagnosticArray(status=[entry])
        message.header.stamp = self.rospy.Time.now()
        self.reports.publish(message)


def main() -> int:
    """Run the node until SIGINT or SIGTERM; zero is published at the end, also of an exception."""
    import signal

    import rospy

    # rospy's own handler closes the topics before the last zero could be published
    rospy.init_node("navrl", disable_signals=True)
    stopping = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopping.set())
    try:
        PolicyNode(rospy).spin(stopping)
    except ValueError as error:
        rospy.logfatal(str(error))
        return 2
    finally:
        rospy.signal_shutdown("end")
    return 0


if __name__ == "__main__":
    sys.exit(main())
