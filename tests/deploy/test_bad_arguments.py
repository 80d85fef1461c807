"""Arguments that are no numbers, or angles in degrees, are named in one line."""

import re

import numpy as np
import pytest

from navrl.deploy import Controller, ControlLimits, SafetyLimits, load_scanner
from navrl.ops.scanner import Scanner
from navrl.policies import ZOO
from navrl.sim import Lidar
from navrl.transforms import MinPool
from navrl.worlds import OccupancyMap

PATH = [(0.0, 0.0), (4.0, 0.0)]  # m


@pytest.fixture(scope="module")
def control():
    return Controller.from_bundle(ZOO / "paper", "rplidar_a1")


def test_bundle_may_be_a_name_of_the_zoo(control):
    named = Controller.from_bundle("paper").runner
    assert named.num_beams == control.runner.num_beams
    with pytest.raises(ValueError, match="papre"):
        Controller.from_bundle("papre")


def raises(text):
    """Expect a ValueError of one line that begins with a text."""
    return pytest.raises(ValueError, match=f"^{re.escape(text)}[^\n]*$")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"mount": None}, "mount=None: must be three finite numbers (x, y, yaw)"),
        ({"mount": (0, 0, "pi")}, "mount=(0, 0, 'pi'): must be three finite numbers"),
        ({"mount": (0, 0, 180)}, "mount=[0.0, 0.0, 180.0]: yaw=180: must be in rad"),
        ({"angle_min": -180.0}, "angle_min=-180: must be in rad, in [-2 pi, 2 pi]"),
        ({"angle_min": "0"}, "angle_min='0': must be finite (rad)"),
        ({"angle_increment": "1"}, "angle_increment='1': must be finite and not 0"),
        ({"range_min": None}, "range_min=None: must be finite and >= 0"),
        ({"range_max": None}, "range_max=None: must be above range_min=0.15"),
        ({"max_beam_width": None}, "max_beam_width=None: must be positive and finite"),
        ({"is_upside_down": "no"}, "is_upside_down='no': must be true or false"),
        ({"zero": ["invalid"]}, "zero=['invalid']: must be one of too_near, no_return"),
        ({"blind_sectors": None}, "blind_sectors=None: must be a list of (bearing, width)"),
        ({"blind_sectors": [(90, 20)]}, "blind_sectors[0].bearing=90: must be in rad"),
        ({"mout": (0, 0, 0)}, "mout=(0, 0, 0): must be one of angle_min, "),
    ],
)
def test_bad_value_of_a_scanner_is_named(arguments, text):
    with raises(text):
        load_scanner("rplidar_a1", **arguments)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("max_speed", "0.5", "positive"),
        ("speed_scale", None, "positive"),
        ("scan_timeout_s", None, "positive and finite"),
        ("max_step_s", "1", "positive"),
    ],
)
def test_limit_that_is_no_number_is_named(name, value, allowed):
    with raises(f"{name}={value!r}: must be {allowed}"):
        ControlLimits(**{name: value})


def test_safety_limits_are_numbers_in_rad():
    with raises("goal_radius=None: must be a number"):
        SafetyLimits(goal_radius=None)
    with raises("max_gap=10: must be in rad"):
        SafetyLimits(max_gap=10.0)


def test_yaw_in_degrees_is_an_error_of_lidar_and_pooling():
    for make in (Lidar, MinPool, Scanner):
        with raises("mount=[0.0, 0.0, 180.0]: yaw=180: must be in rad"):
            make(mount=(0.0, 0.0, 180.0))
        with raises("angle_min=-180: must be in rad"):
            make(angle_min=-180.0)
    with raises("origin=[0.0, 0.0, 90.0]: yaw=90: must be in rad"):
        OccupancyMap(np.zeros((4, 4), np.int8), 0.1, np.array([0.0, 0.0, 90.0]))


@pytest.mark.parametrize(
    ("give", "text"),
    [
        (lambda c: c.tick(None), "now=None: must be a number (s)"),
        (lambda c: c.on_pose(None, (0, 0, 0)), "stamp=None: must be finite (s)"),
        (lambda c: c.on_pose(1.0, None), "pose=None: must be three finite numbers"),
        (lambda c: c.on_pose(1.0, ("a", 0, 0)), "pose=('a', 0, 0): must be three finite"),
        (lambda c: c.on_odometry(1.0, (0, 0, 0), None), "velocity=None: must be 2 finite"),
        (lambda c: c.on_odometry(1.0, (0, 0, 0), (1.0,)), "velocity=[1.0]: must be 2 finite"),
        (lambda c: c.on_scan(1.0, "abc"), "ranges='abc': must be [beams] numbers (m)"),
        (lambda c: c.on_scan(1.0, ["1", "2"]), "ranges=['1', '2']: must be [beams]"),
        (lambda c: c.on_scan(1.0, np.ones(360), -180.0), "angle_min=-180: must be in rad"),
        (lambda c: c.on_scan(1.0, np.ones(360), "a"), "angle_min='a': must be finite (rad)"),
        (lambda c: c.on_scan(1.0, np.ones(9), range_max="a"), "range_max='a': must be above"),
        (lambda c: c.on_path("path"), "path='path': must be [P, 2] numbers (m)"),
        (lambda c: c.on_path([(0, 0), (1,)]), "path=[(0, 0), (1,)]: must be [P, 2] numbers"),
        (lambda c: c.runner.act("abc", (0, 0, 0), PATH), "ranges='abc': must be [beams]"),
        (lambda c: c.runner.act(np.ones(1440), (0, 0, 0), None), "path=None: must be [P, 2]"),
    ],
)
def test_input_that_is_no_number_is_named(control, give, text):
    with raises(text):
        give(control)


def test_point_that_is_no_pair_of_numbers_is_named():
    hall = OccupancyMap(np.zeros((40, 40), np.int8), 0.1, np.zeros(3))
    with raises("start=None: must be 2 numbers (x, y) in m"):
        hall.path(None, [1, 1])
    with raises("goal=[1.0]: must be 2 numbers (x, y) in m"):
        hall.path([1, 1], [1])
