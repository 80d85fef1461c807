"""The ROS 2 node drives over real topics and stops the robot in all circumstances."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from nightly import mostly
from ros_robot import GOAL_X, Robot, network, rclpy, robot

from navrl.worlds import OccupancyMap

__all__ = ["network", "robot"]  # fixtures
pytestmark = pytest.mark.ros


def start(*parameters, code="from navrl.deploy.ros2 import main; raise SystemExit(main())"):
    values = ["pose_source:=amcl_pose", "mount:=[0.0, 0.0, 3.14159265]", "policy:=paper"]
    values += ["scanner:=rplidar_a1", *parameters]
    arguments = [word for value in values for word in ("-p", value)]
    command = [sys.executable, "-c", code, "--ros-args", *arguments]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


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
    assert process.wait(60) == 0, process.stderr.read()


@pytest.mark.slow
def test_node_arrives_and_stops_at_the_goal(robot):
    process = drive(robot)
    assert robot.run(15.0, lambda: robot.pose[0] > GOAL_X - 0.2 and robot.last == (0.0, 0.0))
    assert abs(robot.pose[1]) < 0.5
    finish(process)


@pytest.mark.slow
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


@pytest.mark.parametrize("number", mostly([signal.SIGINT, signal.SIGTERM], [signal.SIGTERM]))
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_path_of_another_frame_is_rejected(robot):
    process = drive(robot)
    robot.send_path("odom")
    assert robot.run(2.0, lambda: robot.last == (0.0, 0.0))
    finish(process)


INVALID = [
    ("policy:=none", "policy=none: must be"),
    ("pose_source:=gps", "pose_source=gps: must be one of tf, amcl_pose, odometry"),
    ("speed_scale:=2.0", "speed_scale=2.0: must be in"),
    ("controller_frequency:=1.0", "controller_frequency=1.0: must be at least 10 Hz"),
    ("mount:=[0.0, 3.14]", "mount=[0.0, 3.14]: must be three finite numbers (x, y, yaw)"),
    ("max_vel_x:=-0.5", "max_vel_x=-0.5: must be positive"),
]


@pytest.mark.parametrize(("parameter", "message"), mostly(INVALID, INVALID[:1]))
def test_invalid_parameter_ends_the_node(parameter, message):
    process = start(parameter)
    assert process.wait(240) == 2
    assert message in process.stderr.read()


@pytest.mark.slow
def test_integers_are_accepted_and_unknown_names_reported():
    process = start("mount:=[0, 0, 3]", "max_vel_x:=1", "max_vel_y:=0.5", "use_sim_time:=false")
    lines = []
    while not (lines and ("ready: " in lines[-1] or not lines[-1])):
        lines.append(process.stderr.readline())
    finish(process)
    warnings = [line for line in lines if "no such parameter" in line]
    assert len(warnings) == 1 and "max_vel_y=0.5" in warnings[0] and "max_vel_x" in warnings[0]
    assert "policy=paper, scanner=rplidar_a1 at mount=[0.000, 0.000, 3.000]" in lines[-1]
    assert "listens to scan, odom, plan, emergency_stop, amcl_pose; publishes cmd_vel" in lines[-1]


@pytest.mark.slow
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
