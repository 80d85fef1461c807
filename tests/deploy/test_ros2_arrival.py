"""The ROS 2 node arrives over real topics; it and a simulated A1 advance by one clock."""

import math
import time
from pathlib import Path

import numpy as np
import pytest
from ros_robot import Robot, network, rclpy
from simulated_a1 import BACKWARDS, STEP_S, SimulatedA1
from test_ros2 import finish, start

from navrl.worlds import OccupancyMap

pytest.importorskip("rosgraph_msgs")
__all__ = ["network"]  # a fixture
pytestmark = pytest.mark.ros
TICK_S, NUM_TICKS = 0.02, 4  # of the node in a step
OFFSET = (0.5, -0.3, 0.2)  # pose of the frame odom in map
WITH_TF = (
    f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
    "import stand_in_tf2; sys.modules['tf2_ros'] = stand_in_tf2.module()\n"
    "from navrl.deploy.ros2 import main; raise SystemExit(main())"
)


class SteppedRobot(Robot):
    """Publisher of a robot's topics whose clock advances with the node's commands."""

    def __init__(self, node):
        from geometry_msgs.msg import TransformStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from rosgraph_msgs.msg import Clock

        super().__init__(node, stamped=True)
        self.now, self.stamps = 1000.0, []
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.clock = node.create_publisher(Clock, "/clock", 10)
        self.tf = node.create_publisher(TransformStamped, "tf", 10)
        self.static = node.create_publisher(TransformStamped, "tf_static", latched)

    def on_command(self, message):
        super().on_command(message)
        self.stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)

    def stamp(self):
        from builtin_interfaces.msg import Time

        nanoseconds = round(self.now * 1e9)
        return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)

    def wait(self, duration, until):
        end = time.monotonic() + duration
        while time.monotonic() < end and not until():
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return until()

    def tick(self):
        """Publish the time until a command has it."""
        from rosgraph_msgs.msg import Clock

        def is_there():
            return bool(self.stamps) and self.stamps[-1] > self.now - 0.5 * TICK_S

        end = time.monotonic() + 60.0
        while not is_there():
            assert time.monotonic() < end, "the node sent no command for a minute"
            self.clock.publish(Clock(clock=self.stamp()))
            self.wait(1.0, is_there)

    def step(self, pose, ranges):
        """Publish the sensors and return the command that follows, (v, w)."""
        self.now += STEP_S - (NUM_TICKS - 1) * TICK_S
        self.tick()
        self.pose = np.asarray(pose, dtype=float)
        self.publish_sensors(ranges)
        self.wait(0.02, lambda: False)
        for _ in range(NUM_TICKS - 1):
            self.now += TICK_S
            self.tick()
        return self.last

    def publish_sensors(self, ranges):
        """Publish scan, odometry, pose and tf; odometry has a frame of its own."""
        self.has_scan = False
        self.publish()
        self.send_frame(self.tf, "map", "odom", OFFSET)
        self.send_frame(self.tf, "odom", "base_link", relative(OFFSET, self.pose))
        scan = self.laser_scan(ranges)
        scan.time_increment = 1e-6
        self.scans.publish(scan)

    def send_frame(self, publisher, parent, child, pose):
        from geometry_msgs.msg import TransformStamped

        message = TransformStamped(child_frame_id=child)
        message.header.frame_id, message.header.stamp = parent, self.stamp()
        x, y, yaw = map(float, pose)
        message.transform.translation.x, message.transform.translation.y = x, y
        turn = message.transform.rotation
        turn.z, turn.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        publisher.publish(message)


def relative(frame, pose):
    """Return a pose of the parent's frame in ``frame``."""
    x, y, yaw = np.asarray(pose) - frame
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    return cos * x + sin * y, cos * y - sin * x, yaw


@pytest.fixture
def robot(network):
    node = rclpy.create_node("stepped_robot")
    yield SteppedRobot(node)
    node.destroy_node()


def started(robot, *parameters, **arguments):
    values = ("use_sim_time:=true", "enable_stamped_cmd_vel:=true", "publish_markers:=false")
    process = start(*values, f"controller_frequency:={1 / TICK_S:.1f}", *parameters, **arguments)
    listening = robot.node.count_subscribers
    assert robot.wait(240.0, lambda: process.poll() is not None or listening("/clock") > 0)
    assert process.poll() is None, process.stderr.read()
    return process


@pytest.mark.slow
def test_nine_of_ten_episodes_arrive_over_topics(robot):
    process = started(robot, "policy:=navrl-best")

    def begin(path):
        robot.now += 100.0
        robot.tick()
        robot.send_points(path)
        robot.wait(0.2, lambda: False)

    outcomes = SimulatedA1().outcomes(range(10), begin, robot.step)
    finish(process)
    assert outcomes.count("success") >= 9, outcomes


def test_goal_on_a_map_is_reached_with_poses_from_tf(robot):
    """The mount of the lidar is read from tf too, and odometry has another frame than the map."""
    values = np.full((100, 24), 0, np.int8)  # 10 m x 2.4 m, the corridor
    values[:, [0, -1]], values[[0, -1]] = 100, 100
    robot.send_map(OccupancyMap(values, 0.1, np.array([-2.0, -1.2, 0.0])))
    robot.send_frame(robot.static, "base_link", "laser", BACKWARDS)
    mount = "mount:=[.nan, .nan, .nan]"
    process = started(robot, "path_source:=map", "pose_source:=tf", mount, code=WITH_TF)
    commands = []

    def drive(num_steps, until):
        for _ in range(num_steps):
            v, w = robot.step(robot.pose, robot.corridor())
            commands.append(v)
            yaw = robot.pose[2] + 0.5 * STEP_S * w
            robot.pose += STEP_S * np.array([v * math.cos(yaw), v * math.sin(yaw), w])
            if until():
                return True
        return False

    assert not drive(5, lambda: robot.last[0] > 0.0)  # no goal
    robot.send_goal(3.0, 0.5)
    assert drive(60, lambda: robot.last == (0.0, 0.0) and max(commands) > 0.3)
    assert math.hypot(robot.pose[0] - 3.0, robot.pose[1] - 0.5) < 0.3
    robot.send_goal(0.0, -0.5)  # back
    assert drive(90, lambda: robot.last == (0.0, 0.0) and robot.pose[0] < 0.5)
    finish(process)
