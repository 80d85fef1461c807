"""The ROS 2 node drives over real topics and stops the robot in all circumstances."""

import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from navrl.worlds import OccupancyMap

pytestmark = pytest.mark.ros
rclpy = pytest.importorskip("rclpy")
for package in ("sensor_msgs", "nav_msgs", "geometry_msgs", "std_msgs", "diagnostic_msgs"):
    pytest.importorskip(package)

GOAL_X = 3.0  # m
BEAMS = 360
BEARING = -np.pi + np.arange(BEAMS) * 2 * np.pi / BEAMS
ENVIRONMENT = {
    "ROS_DOMAIN_ID": str(20 + os.getpid() % 80),
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
}


class Robot:
    """A unicycle in a corridor, with an A1 that is mounted backwards."""

    def __init__(self, node, stamped=False):
        from geometry_msgs.msg import (
            PoseStamped,
            PoseWithCovarianceStamped,
            Twist,
            TwistStamped,
        )
        from nav_msgs.msg import Odometry, Path
        from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
        from sensor_msgs.msg import LaserScan
        from std_msgs.msg import Bool

        self.node, self.pose, self.commands = node, np.zeros(3), []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        make = node.create_publisher
        self.scans = make(LaserScan, "scan", qos_profile_sensor_data)
        self.odometry = make(Odometry, "odom", qos_profile_sensor_data)
        self.poses = make(PoseWithCovarianceStamped, "amcl_pose", latched)
        self.paths, self.stops = make(Path, "plan", 1), make(Bool, "emergency_stop", 1)
        self.goals = make(PoseStamped, "goal_pose", 1)
        kind = TwistStamped if stamped else Twist
        self.subscription = node.create_subscription(kind, "cmd_vel", self.on_command, 10)
        self.random = np.random.default_rng(0)
        self.has_scan = True

    def on_command(self, message):
        twist = message.twist if hasattr(message, "twist") else message
        self.commands.append((time.monotonic(), twist.linear.x, twist.angular.z))

    @property
    def last(self):
        return self.commands[-1][1:] if self.commands else (0.0, 0.0)

    def stamp(self):
        return self.node.get_clock().now().to_msg()

    def publish(self):
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from nav_msgs.msg import Odometry
        from sensor_msgs.msg import LaserScan

        x, y, yaw = self.pose.tolist()
        odometry, pose = Odometry(), PoseWithCovarianceStamped()
        for message, frame in ((odometry, "odom"), (pose, "map")):
            message.header.stamp, message.header.frame_id = self.stamp(), frame
            place = message.pose.pose
            place.position.x, place.position.y = x, y
            place.orientation.z, place.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        odometry.twist.twist.linear.x, odometry.twist.twist.angular.z = self.last
        self.odometry.publish(odometry)
        self.poses.publish(pose)
        if not self.has_scan:
            return
        angle = BEARING + math.pi + yaw  # backwards
        side = np.where(np.sin(angle) > 0, 1.2 - y, 1.2 + y)
        ends = np.where(np.cos(angle) > 0, 6.0 - x, 2.0 + x)
        with np.errstate(divide="ignore"):
            ranges = np.minimum(side / np.abs(np.sin(angle)), ends / np.abs(np.cos(angle)))
        scan = LaserScan(angle_min=-math.pi, angle_max=math.pi, range_min=0.15, range_max=12.0)
        scan.angle_increment = 2 * math.pi / BEAMS
        scan.header.stamp, scan.header.frame_id = self.stamp(), "laser"
        scan.ranges = (ranges + self.random.normal(0, 0.01, BEAMS)).astype(np.float32).tolist()
        self.scans.publish(scan)

    def send_path(self, frame="map"):
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Path

        path = Path()
        path.header.frame_id, path.header.stamp = frame, self.stamp()
        for x in np.arange(0.0, GOAL_X + 0.01, 0.05):
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.orientation.w = float(x), 1.0
            path.poses.append(pose)
        self.paths.publish(path)

    def send_map(self, office):
        from nav_msgs.msg import OccupancyGrid
        from rclpy.qos import DurabilityPolicy, QoSProfile

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.maps = self.node.create_publisher(OccupancyGrid, "map", latched)
        message = OccupancyGrid()
        message.header.frame_id, message.header.stamp = "map", self.stamp()
        message.info.width, message.info.height = office.values.shape
        message.info.resolution = office.cell
        place = message.info.origin
        place.position.x, place.position.y, place.orientation.w = *office.origin[:2].tolist(), 1.0
        message.data = office.values.T.ravel().tolist()
        self.maps.publish(message)

    def send_goal(self, x, y):
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        message.header.frame_id, message.header.stamp = "map", self.stamp()
        message.pose.position.x, message.pose.position.y = x, y
        self.goals.publish(message)

    def run(self, duration, until=lambda: False):
        """Move for a time, s, with scans and odometry at 10 Hz; return whether ``until`` held."""
        end, step = time.monotonic() + duration, 0.02
        following = publishing = time.monotonic()
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.005)
            if time.monotonic() >= following:
                v, w = self.last
                self.pose += step * np.array(
                    [v * np.cos(self.pose[2]), v * np.sin(self.pose[2]), w]
                )
                following += step
            if time.monotonic() >= publishing:
                self.publish()
                publishing += 0.1
            if until():
                return True
        return False


@pytest.fixture(scope="module", autouse=True)
def network():
    os.environ |= ENVIRONMENT
    rclpy.init()
    yield
    rclpy.shutdown()


def start(*parameters, code="from navrl.deploy.ros2 import main; raise SystemExit(main())"):
    values = ["pose_source:=amcl_pose", "mount:=[0.0, 0.0, 3.14159265]", "policy:=paper"]
    values += ["scanner:=rplidar_a1", *parameters]
    arguments = [word for value in values for word in ("-p", value)]
    command = [sys.executable, "-c", code, "--ros-args", *arguments]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def robot():
    node = rclpy.create_node("simulated_robot")
    robot = Robot(node)
    yield robot
    node.destroy_node()


def drive(robot, *parameters, send=Robot.send_path, **arguments):
    """Start a node and wait until it drives."""
    process = start(*parameters, **arguments)
    robot.run(240.0, lambda: bool(robot.commands) or process.poll() is not None)
    assert process.poll() is None, process.stderr.read()
    assert all(command[1:] == (0.0, 0.0) for command in robot.commands)  # no path
    send(robot)
    assert robot.run(10.0, lambda: robot.last[0] > 0.3)
    return process


def finish(process):
    process.send_signal(signal.SIGINT)
    assert process.wait(10) == 0, process.stderr.read()


def test_node_arrives_and_stops_at_the_goal(robot):
    process = drive(robot)
    assert robot.run(15.0, lambda: robot.pose[0] > GOAL_X - 0.2 and robot.last == (0.0, 0.0))
    assert abs(robot.pose[1]) < 0.5
    finish(process)


def test_node_plans_to_goals_on_a_latched_map(robot):
    from diagnostic_msgs.msg import DiagnosticArray

    values = np.full((100, 24), 0, np.int8)  # 10 m x 2.4 m, the corridor
    values[:, [0, -1]], values[[0, -1]], values[45:50, 8:16] = 100, 100, 100  # and a box in it
    robot.send_map(OccupancyMap(values, 0.1, np.array([-2.0, -1.2, 0.0])))
    texts, kept = (
        [],
        robot.node.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda message: texts.append(message.status[0].message),
            1,
        ),
    )
    process = drive(robot, "path_source:=map", send=lambda robot: robot.send_goal(1.5, 0.0))
    robot.send_goal(2.7, 0.0)  # in the box
    assert robot.run(3.0, lambda: any("must not be in an obstacle" in text for text in texts))
    assert robot.last == (0.0, 0.0)
    robot.send_goal(GOAL_X + 1.0, 0.0)
    end = (GOAL_X + 0.8, 0.0)
    assert robot.run(20.0, lambda: robot.pose[0] > end[0] and robot.last == end[1:] * 2)
    robot.node.destroy_subscription(kept)
    finish(process)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_last_command_of_an_interrupted_node_is_zero(robot, number):
    process = drive(robot)
    process.send_signal(number)
    robot.run(3.0, lambda: process.poll() is not None and robot.last == (0.0, 0.0))
    assert process.wait(5) == 0 and robot.last == (0.0, 0.0)


def test_robot_stops_within_the_scan_timeout(robot):
    process = drive(robot)
    robot.has_scan, begin = False, time.monotonic()
    assert robot.run(3.0, lambda: robot.last == (0.0, 0.0))
    assert time.monotonic() - begin < 0.5 + 0.182 + 0.1 + 0.1  # timeout, revolution, tick, ours
    robot.has_scan = True
    assert robot.run(3.0, lambda: robot.last[0] > 0.3)
    finish(process)


def test_emergency_stop_topic_stops_the_robot(robot):
    from std_msgs.msg import Bool

    process = drive(robot)
    robot.stops.publish(Bool(data=True))
    assert robot.run(1.0, lambda: robot.last == (0.0, 0.0))
    robot.run(0.5)
    assert robot.last == (0.0, 0.0)
    robot.stops.publish(Bool(data=False))
    assert robot.run(2.0, lambda: robot.last[0] > 0.3)
    finish(process)


def test_exception_in_a_callback_stops_the_robot(robot):
    code = (
        "from navrl.deploy import ros2\n"
        "tick, count = ros2.PolicyNode.tick, []\n"
        "def failing(self):\n"
        "    tick(self)\n"
        "    count.append(self.control.status.command.v > 0)\n"
        "    assert sum(count) < 20, 'broken'\n"
        "ros2.PolicyNode.tick = failing\n"
        "ros2.main()"
    )
    process = drive(robot, code=code)
    assert robot.run(10.0, lambda: process.poll() is not None)
    robot.run(0.3)
    assert process.returncode == 1 and "broken" in process.stderr.read()
    assert robot.last == (0.0, 0.0)


def test_path_of_another_frame_is_rejected(robot):
    process = drive(robot)
    robot.send_path("odom")
    assert robot.run(2.0, lambda: robot.last == (0.0, 0.0))
    finish(process)


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        ("policy:=none", "policy=none: must be"),
        ("pose_source:=gps", "pose_source=gps: must be one of tf, amcl_pose, odometry"),
        ("speed_scale:=2.0", "speed_scale=2.0: must be in"),
        ("controller_frequency:=1.0", "controller_frequency=1.0: must be at least 10 Hz"),
    ],
)
def test_invalid_parameter_ends_the_node(parameter, message):
    process = start(parameter)
    assert process.wait(240) == 2
    assert message in process.stderr.read()


def test_stamped_commands_are_scaled():
    node = rclpy.create_node("stamped_robot")
    stamped = Robot(node, stamped=True)
    process = start("enable_stamped_cmd_vel:=true", "speed_scale:=0.3")
    assert stamped.run(240.0, lambda: bool(stamped.commands))
    stamped.send_path()
    assert stamped.run(10.0, lambda: stamped.last[0] > 0.2)
    stamped.run(1.0)
    assert max(command[1] for command in stamped.commands) <= 0.3 + 1e-6
    finish(process)
    node.destroy_node()
