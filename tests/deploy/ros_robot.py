"""A simulated robot on real ROS 2 topics of this computer; tests skip without ROS."""

import math
import os
import time

import numpy as np
import pytest

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
        if self.has_scan:
            self.scans.publish(self.laser_scan(self.corridor()))

    def corridor(self):
        """Return the ranges in a corridor from -2 to 6 m and -1.2 to 1.2 m, ``[360]`` m."""
        x, y, yaw = self.pose.tolist()
        angle = BEARING + math.pi + yaw  # backwards
        side = np.where(np.sin(angle) > 0, 1.2 - y, 1.2 + y)
        ends = np.where(np.cos(angle) > 0, 6.0 - x, 2.0 + x)
        with np.errstate(divide="ignore"):
            ranges = np.minimum(side / np.abs(np.sin(angle)), ends / np.abs(np.cos(angle)))
        return ranges + self.random.normal(0, 0.01, BEAMS)

    def laser_scan(self, ranges):
        from sensor_msgs.msg import LaserScan

        scan = LaserScan(angle_min=-math.pi, angle_max=math.pi, range_min=0.15, range_max=12.0)
        scan.angle_increment = 2 * math.pi / BEAMS
        scan.header.stamp, scan.header.frame_id = self.stamp(), "laser"
        scan.ranges = ranges.astype(np.float32).tolist()
        return scan

    def send_path(self, frame="map"):
        self.send_points([(x, 0.0) for x in np.arange(0.0, GOAL_X + 0.01, 0.05)], frame)

    def send_points(self, points, frame="map"):
        from geometry_msgs.msg import PoseStamped
        from nav_msgs.msg import Path

        path = Path()
        path.header.frame_id, path.header.stamp = frame, self.stamp()
        for x, y in points:
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.position.y = float(x), float(y)
            pose.pose.orientation.w = 1.0
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
    """Give the tests of a module a ROS network of their own."""
    os.environ |= ENVIRONMENT
    rclpy.init()
    yield
    rclpy.shutdown()


@pytest.fixture
def robot():
    """Return a robot on the network."""
    node = rclpy.create_node("simulated_robot")
    yield Robot(node)
    node.destroy_node()
