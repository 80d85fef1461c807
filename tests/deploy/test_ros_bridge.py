"""Messages of ROS become inputs of the controller; the nodes share parameters and page."""

import math
import re
from types import SimpleNamespace as Message

import numpy as np
import pages
import pytest

from navrl.deploy import Controller, DriveState
from navrl.deploy.ros_bridge import RosBridge, diagnostic_values, planar_yaw, seconds
from navrl.deploy.ros_markers import attention_spheres, group_arrows
from navrl.deploy.ros_parameters import PARAMETERS, make_controller
from navrl.policies import ZOO

PAGE = pages.ROOT / "docs" / "ros.md"


def stamp(time):
    return Message(sec=int(time), nanosec=round((time % 1) * 1e9))


def header(time, frame="map"):
    return Message(stamp=stamp(time), frame_id=frame)


def pose(x, y, yaw):
    turn = Message(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return Message(position=Message(x=x, y=y, z=0.0), orientation=turn)


def scan(time, ranges=None, **changes):
    fields = {
        "header": header(time, "laser"),
        "angle_min": -math.pi,
        "angle_increment": 2 * math.pi / 360,
        "time_increment": 0.0005,
        "range_min": 0.15,
        "range_max": 12.0,
        "ranges": np.full(360, 2.0) if ranges is None else ranges,
    }
    return Message(**{**fields, **changes})


def odometry(time, x=0.0, v=0.0):
    twist = Message(linear=Message(x=v), angular=Message(z=0.0))
    return Message(
        header=header(time, "odom"), pose=Message(pose=pose(x, 0, 0)), twist=Message(twist=twist)
    )


def path(frame="map", length=81):
    points = [Message(pose=pose(0.05 * i, 0.0, 0.0)) for i in range(length)]
    return Message(header=header(0.0, frame), poses=points)


@pytest.fixture(scope="module")
def loaded():
    return Controller.from_bundle(ZOO / "paper", with_attention=True)


@pytest.fixture
def bridge(loaded):
    loaded.tick(-1e6)  # a clock that goes back clears the inputs
    loaded.tick(99.5)
    loaded.runner.reset()
    warnings = []
    made = RosBridge(loaded, "map", warnings.append)
    made.warnings = warnings
    made.on_path(path())
    made.on_pose(odometry(100.0))
    made.on_odometry(odometry(100.0))
    made.on_scan(scan(99.8))
    return made


def test_messages_drive_the_robot(bridge):
    v, _, state = bridge.control.tick(100.0)
    assert v > 0.5 and state is DriveState.DRIVE and not bridge.warnings
    assert bridge.control.status.scan_age_s == pytest.approx(0.2 - 359 * 0.0005)


@pytest.mark.parametrize(
    ("give", "message", "state"),
    [
        (lambda b: b.on_path(path("odom")), "path: frame_id='odom'", DriveState.NO_PATH),
        (lambda b: b.on_scan(scan(99.9, angle_increment=0.0)), "scan: ang", DriveState.STALE_SCAN),
        (lambda b: b.on_scan(scan(99.9, ranges=[])), "scan: ranges", DriveState.STALE_SCAN),
        (lambda b: b.on_pose(odometry(100.0, math.nan)), "pose: pose=", DriveState.STALE_POSE),
    ],
)
def test_invalid_message_warns_and_stops(bridge, give, message, state):
    give(bridge)
    assert bridge.control.tick(100.0) == (0.0, 0.0, state)
    assert len(bridge.warnings) == 1 and bridge.warnings[0].startswith(message)


def test_empty_path_and_emergency_stop(bridge):
    bridge.on_emergency_stop(Message(data=True))
    assert bridge.control.tick(100.0).state is DriveState.EMERGENCY_STOP
    bridge.on_emergency_stop(Message(data=False))
    assert bridge.control.tick(100.0).v > 0.5
    bridge.on_path(path(length=0))
    assert bridge.control.tick(100.05).state is DriveState.NO_PATH


def test_times_and_orientations_of_both_versions():
    assert seconds(stamp(12.25)) == seconds(Message(to_sec=lambda: 12.25)) == 12.25
    assert planar_yaw(pose(0, 0, 2.5).orientation) == pytest.approx(2.5)
    assert math.isnan(planar_yaw(Message(x=0.0, y=0.0, z=0.0, w=0.0)))


def test_diagnostics_and_markers_follow_the_status(bridge):
    bridge.control.tick(100.0)
    bridge.on_scan(scan(100.0))
    bridge.on_odometry(odometry(100.2))
    bridge.control.tick(100.2)
    level, text, values = diagnostic_values(bridge.control.status)
    assert (level, text) == (0, "drive") and values["num_steps"].isdigit()
    spheres = attention_spheres(bridge.control.status)
    assert [spheres[0].kind, spheres[1].kind, len(spheres)] == ["scan", "attention", 31]
    assert len(spheres[0].points) == 180
    assert all(arrow.points.shape == (2, 2) for arrow in group_arrows(bridge.control.status))
    bridge.control.tick(200.0)
    assert diagnostic_values(bridge.control.status)[0] == 2


def test_parameters_set_the_limits():
    values = {**PARAMETERS, "policy": "paper", "max_vel_x": 0.22, "decel_lim_x": -2.5}
    values |= {"scan_timeout": 0.3, "xy_goal_tolerance": 0.25, "blind_sectors": [1.0, 0.1]}
    control = make_controller(values, (0.1, 0.0, 0.0))
    assert control.limits.max_speed == 0.22 and control.limits.linear_deceleration == 2.5
    assert control.limits.scan_timeout_s == 0.3 and control.runner.limits.goal_radius == 0.25
    scanner = control._inputs.scanner
    assert list(scanner.mount) == [0.1, 0.0, 0.0] and scanner.blind_sectors == [[1.0, 0.1]]


@pytest.mark.parametrize(
    ("name", "value"),
    [("policy", "none"), ("speed_scale", 2.0), ("blind_sectors", [1.0]), ("scanner", "a9")],
)
def test_invalid_parameter_is_named(name, value):
    values = {**PARAMETERS, "policy": "paper", name: value}
    with pytest.raises(ValueError, match=f"{name}="):
        make_controller(values, (0.0, 0.0, 0.0))


def test_page_lists_each_parameter():
    listed = set(re.findall(r"`(\w+)`", PAGE.read_text()))
    assert set(PARAMETERS) <= listed


def test_ros_1_node_needs_rospy():
    rospy = pytest.importorskip("rospy")
    from navrl.deploy.ros1 import PolicyNode

    assert callable(rospy.init_node) and callable(PolicyNode)
