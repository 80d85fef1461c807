"""Goals on a map become paths, planned while the robot is stationary; refusals have a reason."""

import math
from types import SimpleNamespace as Message

import numpy as np
import pytest
from map_files import write_map
from test_ros_bridge import header, odometry, path, pose, scan

from navrl.deploy import Controller, DriveState, MapPlanner
from navrl.deploy.ros_bridge import RosBridge, diagnostic_values, fill_path
from navrl.deploy.ros_parameters import PARAMETERS, checked_parameters, make_planner
from navrl.policies import ZOO
from navrl.worlds import load_occupancy_map


@pytest.fixture(scope="module")
def loaded():
    return Controller.from_bundle(ZOO / "paper")


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    """Two rooms of 3 m x 4 m with a door, see map_files."""
    return load_occupancy_map(write_map(tmp_path_factory.mktemp("map")))


def grid(office, frame="map"):
    width, height = office.values.shape
    x, y, yaw = office.origin.tolist()
    info = Message(width=width, height=height, resolution=office.cell, origin=pose(x, y, yaw))
    return Message(header=header(0.0, frame), info=info, data=office.values.T.ravel())


def goal(x, y, frame="map"):
    return Message(header=header(0.0, frame), pose=pose(x, y, 0.0))


def at(time, x=1.0, y=1.0):
    message = odometry(time, x)
    message.pose.pose.position.y = y
    return message


@pytest.fixture
def bridge(loaded):
    loaded.tick(-1e6)  # a clock that goes back clears the inputs
    loaded.tick(99.5)
    loaded.runner.reset()
    loaded.on_path(None)
    sent, warnings = [], []
    planner = make_planner({**PARAMETERS, "path_source": "map"}, loaded, sent.append)
    made = RosBridge(loaded, "map", warnings.append, planner)
    made.sent, made.warnings = sent, warnings
    made.on_scan(scan(99.8))
    made.on_pose(at(100.0))
    made.on_odometry(at(100.0))
    return made


def plan(bridge, now=100.0):
    """Tick and poll until a goal is planned; return the command before."""
    command = bridge.control.tick(now)
    bridge.planner.poll()
    bridge.planner.wait()
    bridge.planner.poll()
    return command


def test_goal_on_a_map_drives_the_robot(bridge, office):
    bridge.on_map(grid(office))
    bridge.on_goal(goal(5.0, 1.0))
    assert plan(bridge).state is DriveState.NO_PATH
    wanted = office.path([1.0, 1.0], [5.0, 1.0], clearance=0.178 + 0.05)
    assert np.array_equal(bridge.sent[0], wanted) and bridge.planner.reason == ""
    command = bridge.control.tick(100.0)
    assert command.state is DriveState.DRIVE and not bridge.warnings
    assert bridge.control.status.goal_distance_m == pytest.approx(4.0, abs=0.01)


def test_goal_may_come_before_map_and_pose(loaded, office):
    loaded.tick(-1e6)
    loaded.on_path(None)
    planner = MapPlanner(loaded)
    planner.set_goal((5.0, 1.0))
    loaded.tick(100.0)
    planner.poll()
    assert planner.reason == "goal=[5.00, 1.00]: waits for a map" and not planner.is_refused
    planner.set_map(office)
    planner.poll()
    assert planner.reason.endswith("waits for a pose")
    loaded.on_pose(99.0, (1.0, 1.0, 0.0))  # too old
    loaded.tick(100.0)
    planner.poll()
    assert planner.reason.endswith("waits for a pose")
    loaded.on_pose(100.1, (1.0, 1.0, 0.0))
    loaded.tick(100.1)
    planner.poll()
    planner.wait()
    planner.poll()
    assert planner.reason == "" and loaded.tick(100.1).state is not DriveState.NO_PATH


def test_new_goal_stops_the_robot_before_it_is_planned(bridge, office):
    bridge.on_map(grid(office))
    bridge.on_goal(goal(5.0, 1.0))
    plan(bridge)
    assert bridge.control.tick(100.0).state is DriveState.DRIVE
    bridge.on_goal(goal(1.0, -0.5))
    bridge.planner.poll()  # no tick has seen the goal yet
    assert len(bridge.sent) == 1 and bridge.planner.reason.endswith("waits for a tick")
    assert plan(bridge, 100.05)[:2] == (0.0, 0.0)
    assert bridge.sent[1][-1].tolist() == [1.0, -0.5]


def test_path_to_a_replaced_goal_is_dropped(bridge, office):
    bridge.on_map(grid(office))
    bridge.on_goal(goal(5.0, 1.0))
    bridge.control.tick(100.0)
    bridge.planner.poll()
    bridge.on_goal(goal(1.0, -0.5))
    bridge.planner.wait()
    bridge.planner.poll()
    assert not bridge.sent and bridge.control.tick(100.0).state is DriveState.NO_PATH
    plan(bridge)
    assert [path[-1].tolist() for path in bridge.sent] == [[1.0, -0.5]]


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (goal(3.1, 1.0), "goal=[3.10, 1.00]: must not be in an obstacle"),
        (goal(20.0, 1.0), "goal=[20.00, 1.00]: must be inside the map"),
        (goal(-0.5, -1.9), "goal=[-0.50, -1.90]: must not be in an unknown part of the map"),
        (goal(math.nan, 1.0), "goal=[nan, 1.00]: must be inside the map"),
        (goal(1.0, 1.0, "odom"), "goal: frame_id='odom': must be the global_frame 'map'"),
    ],
)
def test_unreachable_goal_stops_the_robot_with_a_reason(bridge, office, message, text):
    bridge.on_map(grid(office))
    bridge.on_goal(goal(5.0, 1.0))
    plan(bridge)
    assert bridge.control.tick(100.0).state is DriveState.DRIVE
    bridge.on_goal(message)
    plan(bridge, 100.05)
    assert bridge.control.tick(100.1) == (0.0, 0.0, DriveState.NO_PATH)
    level, shown, _ = diagnostic_values(bridge.control.status, bridge.planner)
    assert (level, shown) == (2, f"no_path: {text}")
    bridge.on_goal(goal(1.0, -0.5))
    plan(bridge, 100.1)
    assert bridge.control.tick(100.1).state is DriveState.DRIVE


def test_malformed_map_refuses_the_goal(bridge, office):
    broken = grid(office)
    broken.info.width = 3
    bridge.on_map(broken)
    bridge.on_goal(goal(5.0, 1.0))
    plan(bridge)
    assert bridge.planner.is_refused and bridge.planner.reason.startswith("map: width=3, height=60")
    bridge.on_map(grid(office, "odom"))
    assert bridge.warnings == ["map: frame_id='odom': must be the global_frame 'map'"]


def test_planned_path_becomes_a_message():
    def empty():
        return Message(pose=Message(position=Message(), orientation=Message()))

    points = np.array([[1.0, 2.0], [1.5, 2.5]])
    message = fill_path(Message(header=Message()), empty, points, 7.0, "map")
    assert (message.header.stamp, message.header.frame_id) == (7.0, "map")
    places = [(each.pose.position.x, each.pose.position.y) for each in message.poses]
    assert places == [(1.0, 2.0), (1.5, 2.5)] and message.poses[0].pose.orientation.w == 1.0


def test_paths_of_a_planner_are_the_default(bridge):
    assert make_planner(PARAMETERS, bridge.control, print) is None
    plain = RosBridge(bridge.control, "map", bridge.warnings.append)
    plain.on_path(path())
    plain.on_goal(goal(1.0, 1.0))
    assert bridge.control.tick(100.0).state is not DriveState.NO_PATH


def test_invalid_values_are_named(bridge):
    with pytest.raises(ValueError, match="path_source=costmap: must be one of plan, map"):
        checked_parameters({**PARAMETERS, "path_source": "costmap"}, ("tf",))
    with pytest.raises(ValueError, match=r"robot_radius=-1.0: must be > 0 m"):
        make_planner(
            {**PARAMETERS, "path_source": "map", "robot_radius": -1.0}, bridge.control, print
        )
