"""The doctor listens to real ROS 2 topics."""

import threading

import pytest
from ros_robot import network, robot

from navrl.deploy import ControlLimits
from navrl.deploy.bags import LogSource, Topics, listen
from navrl.deploy.doctor import measure_log
from navrl.deploy.doctor_checks import diagnose
from navrl.deploy.doctor_findings import Checked, Level
from navrl.ops.scanner import Scanner
from navrl.policies import ZOO, load_bundle

__all__ = ["network", "robot"]  # fixtures
pytestmark = pytest.mark.ros


@pytest.fixture
def heard(robot):
    """Return what was heard for six seconds of a robot that drives an arc."""
    robot.commands.append((0.0, 0.4, 0.15))
    robot.send_path()
    driving = threading.Thread(target=robot.run, args=(9.0,))
    driving.start()
    log = listen("ros2", 6.0)
    driving.join()
    return log


@pytest.mark.slow
def test_doctor_finds_a_backward_mount_on_live_topics(heard):
    counts = {name: topic.count for name, topic in heard.topics.items()}
    assert counts["/scan"] > 20 and counts["/odom"] > 20 and counts["/amcl_pose"] > 20
    assert heard.topics["/scan"].reliability == "best_effort"
    assert heard.topics["/amcl_pose"].durability == "transient_local"
    source, bundle = LogSource(heard, Topics()), load_bundle(ZOO / "paper")
    lidar, drive = bundle.build("lidar"), bundle.build("robot")
    for yaw, level in ((0.0, Level.FAILURE), (3.14159, Level.OK)):
        scanner, origin = source.scanner(source.first_scan(), Scanner(range_max=100.0), (0, 0, yaw))
        found = measure_log(source, scanner, lidar, drive)
        facts = Checked(found, source, scanner, origin, lidar, drive, ControlLimits(), 0.2)
        (mount,) = (each for each in diagnose(facts) if each.subject == "mount")
        assert mount.level is level and ("'mount=[0,0," in mount.action) == (yaw == 0.0), mount
    assert found.angles == {(-3.141593, 0.017453)} and found.beams == {360}
