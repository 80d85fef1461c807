"""The runner stops a robot that is blind, blocked, lost or at its goal."""

import dataclasses
import math

import numpy as np
import pages
import pytest
import torch
from tensordict.nn import TensorDictModule

from navrl import keys
from navrl.deploy import DriveState, PolicyRunner, SafetyLimits, ScanCheck
from navrl.policies import ZOO, load_bundle
from navrl.sim import DifferentialDrive, Lidar
from navrl.transforms import compose

BEAMS = 1440
PATH = [(0.1 * i, 0.0) for i in range(41)]  # m, straight ahead
DEGREE = BEAMS // 360  # beams


def corridor(half_width=1.5, max_range=25.0):
    """Ranges, m, between two walls of unlimited length."""
    bearing = np.arange(BEAMS) * 2 * np.pi / BEAMS
    return np.minimum(half_width / np.maximum(np.abs(np.sin(bearing)), 1e-9), max_range)


def but(count, value, others):
    ranges = np.full(BEAMS, others)
    ranges[:count] = value
    return ranges


def with_sector(value, first_degree, last_degree):
    """A corridor whose beams read ``value`` from one bearing to another, degrees."""
    ranges = corridor()
    ranges[np.arange(first_degree * DEGREE, last_degree * DEGREE) % BEAMS] = value
    return ranges


DEAD = {
    "all inf": np.full(BEAMS, np.inf),
    "all zero": np.zeros(BEAMS),
    "all the policy's largest range": np.full(BEAMS, 3.5),
    "all the sensor's largest range": np.full(BEAMS, 25.0),
    "inf and the sensor's largest range": but(700, 25.0, np.inf),
    "all NaN": np.full(BEAMS, np.nan),
    "all negative": np.full(BEAMS, -1.0),
    "all NaN but one": but(1, 3.0, np.nan),
    "all inf but 14": but(14, 3.0, np.inf),
    "all zero but 14": but(14, 3.0, 0.0),
    "integer millimeters": (1000 * corridor()).astype(np.int64),
    "millimeters": 1000 * corridor(),
    "NaN ahead": with_sector(np.nan, -10, 11),
    "negative ahead": with_sector(-1.0, -10, 11),
    "NaN to the left": with_sector(np.nan, 60, 75),
}


@pytest.fixture(scope="module", params=["paper", "navrl-best"])
def runner(request):
    return PolicyRunner.from_bundle(ZOO / request.param)


def constant(action, robot=None, limits=None):
    """A runner whose policy answers the same whatever it sees."""
    answer = torch.nn.Module()
    answer.forward = lambda ranges: torch.tensor([action]).expand(len(ranges), 2)
    actor = TensorDictModule(answer, [keys.RANGES], [keys.ACTION])
    return PolicyRunner(compose(), actor, Lidar(BEAMS), robot or DifferentialDrive(), limits)


def check(limits=None, robot=None, **lidar):
    return ScanCheck(Lidar(BEAMS, **lidar), robot or DifferentialDrive(), limits or SafetyLimits())


# --- the scan ------------------------------------------------------------------------------------


def test_working_lidar_drives(runner):
    runner.reset()
    assert runner.act(corridor(), (0, 0, 0), PATH)[0] > 0.9
    assert runner.state is DriveState.DRIVE


@pytest.mark.parametrize("name", DEAD)
def test_dead_lidar_stops_the_robot(runner, name):
    for is_moving in (False, True):
        runner.reset()
        if is_moving:
            runner.act(corridor(), (0, 0, 0), PATH)
        assert runner.act(DEAD[name], (0, 0, 0), PATH).tolist() == [0.0, 0.0]
        assert runner.state is DriveState.BLIND


@pytest.mark.parametrize("degree", [0, 60, -90])
def test_reading_below_minimum_range_ahead_stops_the_robot(runner, degree):
    ranges = corridor()
    ranges[degree * DEGREE] = -np.inf
    runner.reset()
    assert runner.act(ranges, (0, 0, 0), PATH).tolist() == [0.0, 0.0]
    assert runner.state is DriveState.BLOCKED
    assert runner.act(corridor(), (0, 0, 0), PATH)[0] > 0.9


def test_reading_below_minimum_range_behind_is_an_obstacle():
    ranges = with_sector(-np.inf, 170, 190)
    scan_check = check()
    assert scan_check.state(ranges) is DriveState.DRIVE
    cleaned = scan_check.cleaned(ranges)
    assert np.flatnonzero(cleaned == np.float32(0.178)).tolist() == [*range(680, 760)]
    assert check(robot=DifferentialDrive(min_speed=-0.5)).state(ranges) is DriveState.BLOCKED


def test_scan_without_returns_is_blind_by_default():
    empty, person = np.full(BEAMS, np.inf), but(30, 3.0, np.inf)  # 0.4 m wide
    assert check().state(empty) is DriveState.BLIND
    assert check().state(person) is DriveState.DRIVE
    relaxed = SafetyLimits(min_measured_share=0.0)
    assert check(relaxed).state(empty) is DriveState.DRIVE
    for name in ("all NaN", "all negative", "millimeters", "NaN ahead"):
        assert check(relaxed).state(DEAD[name]) is DriveState.BLIND


def test_scan_in_millimeters_measures_nothing():
    assert check(SafetyLimits(max_gap=6.2)).state(DEAD["millimeters"]) is DriveState.BLIND


@pytest.mark.parametrize("code", [25.0, 65.533, 655.35, 3e38, np.inf, 0.0])
def test_code_for_no_return_is_free(code):
    ranges = with_sector(code, -30, 30)
    assert check().state(ranges) is DriveState.DRIVE
    assert (check().cleaned(ranges)[: 30 * DEGREE] == 3.5).all()


def test_simulated_scans_may_be_empty_and_far_from_the_path():
    runner = constant([1.0, 0.0], limits=SafetyLimits.simulated())
    runner.act(np.full(BEAMS, 3.5), (0, 9, 0), PATH)
    assert runner.state is DriveState.DRIVE


def test_limits_reach_the_runner_of_a_bundle():
    runner = PolicyRunner.from_bundle(ZOO / "paper", limits=SafetyLimits(goal_radius=0.5))
    runner.act(corridor(), (3.6, 0, 0), PATH)
    assert runner.state is DriveState.AT_GOAL


def test_distances_beyond_the_policy_range_are_measured():
    plaza = np.linspace(9.0, 18.0, BEAMS)
    assert check().state(plaza) is DriveState.DRIVE
    assert check().cleaned(plaza).tolist() == [3.5] * BEAMS


@pytest.mark.parametrize(("degrees", "state"), [(10, DriveState.DRIVE), (11, DriveState.BLIND)])
def test_gap_of_invalid_beams_ahead_is_limited(degrees, state):
    assert check().state(with_sector(np.nan, -5, degrees - 5)) is state
    assert check(SafetyLimits(max_gap=0.3)).state(with_sector(np.nan, -5, 6)) is DriveState.DRIVE


def test_gap_behind_is_limited_if_the_robot_may_reverse():
    lidar_of_240_degrees = with_sector(np.nan, 120, 240)
    assert check().state(lidar_of_240_degrees) is DriveState.DRIVE
    assert check(SafetyLimits(sector=math.pi)).state(lidar_of_240_degrees) is DriveState.BLIND
    reversing = DifferentialDrive(min_speed=-0.5)
    assert check(robot=reversing).state(lidar_of_240_degrees) is DriveState.BLIND


def test_sector_ahead_follows_the_lidar_mount():
    behind = with_sector(np.nan, 120, 240)
    assert check(mount=(0.0, 0.0, math.pi)).state(behind) is DriveState.BLIND
    assert check(mount=(0.0, 0.0, math.pi)).state(with_sector(np.nan, -60, 60)) is DriveState.DRIVE


def test_scan_without_two_thirds_of_beams_is_not_blind():
    ranges = corridor()
    ranges[np.random.default_rng(0).random(BEAMS) < 0.66] = np.nan
    assert check().state(ranges) is DriveState.DRIVE


def test_blind_scan_is_not_stored(runner):
    near = with_sector(1.0, -20, 20)
    commands = []
    for blind in ([], [DEAD["all inf"], DEAD["all NaN"]]):
        runner.reset()
        runner.act(corridor(), (0, 0, 0), PATH)
        for ranges in blind:
            runner.act(ranges, (0, 0, 0), PATH)
        commands.append(runner.act(near, (0, 0, 0), PATH))
    assert np.array_equal(*commands)


# --- the place -----------------------------------------------------------------------------------


@pytest.mark.parametrize("x", [3.81, 4.0, 4.19])
def test_robot_at_the_goal_stops(runner, x):
    runner.reset()
    assert runner.act(corridor(), (x, 0, 0), PATH).tolist() == [0.0, 0.0]
    assert runner.state is DriveState.AT_GOAL


def test_robot_outside_the_goal_radius_drives(runner):
    runner.reset()
    runner.act(corridor(), (3.7, 0, 0), PATH)
    assert runner.state is DriveState.DRIVE


@pytest.mark.parametrize("pose", [(1, 5, 0), (1, -2.1, 0), (7, 0, 0), (3e38, 0, 0), (1e3, 1e3, 0)])
def test_robot_far_from_its_path_stops_and_resets_the_pose(runner, pose):
    commands = []
    for is_lost in (False, True):
        runner.reset()
        runner.act(corridor(), (0, 0, 0), PATH)
        if is_lost:
            assert runner.act(corridor(), pose, PATH).tolist() == [0.0, 0.0]
            assert runner.state is DriveState.OFF_PATH
        commands.append(runner.act(corridor(), (0.1, 0, 0), PATH))
    assert np.array_equal(*commands)


def test_path_distance_is_measured_to_its_segments():
    limits = SafetyLimits(max_path_distance=0.5)
    runner = constant([1.0, 0.0], limits=limits)
    for y, state in ((0.4, DriveState.DRIVE), (0.6, DriveState.OFF_PATH)):
        runner.act(corridor(), (5.0, y, 0.0), [(0.0, 0.0), (10.0, 0.0)])
        assert runner.state is state
    runner.act(corridor(), (5.0, 0.4, 0.0), [(5.0, 0.0)])
    assert runner.state is DriveState.DRIVE


def test_states_are_exact_in_large_coordinates():
    east, north = 5e5, 5.6e6  # m, UTM: float32 is 0.5 m apart there
    path = np.array(PATH) + np.array([east, north])
    runner = constant([1.0, 0.0])
    for x, state in ((3.79, DriveState.DRIVE), (3.81, DriveState.AT_GOAL)):
        runner.act(corridor(), (east + x, north, 0.0), path)
        assert runner.state is state


# --- the command ---------------------------------------------------------------------------------


@pytest.mark.parametrize("action", [[math.nan, 0.0], [0.5, math.nan], [math.inf, 0.0]])
def test_non_finite_command_becomes_zero(action):
    runner = constant(action)
    assert runner.act(corridor(), (0, 0, 0), PATH).tolist() == [0.0, 0.0]
    assert runner.state is DriveState.BAD_COMMAND


def test_command_beyond_the_limits_is_clipped():
    runner = constant([7.0, -9.0], DifferentialDrive(max_speed=0.4, max_turn_rate=0.5))
    np.testing.assert_allclose(runner.act(corridor(), (0, 0, 0), PATH), [0.4, -0.5])
    assert runner.state is DriveState.DRIVE


def test_reversing_robot_gets_its_own_limits():
    runner = constant([-1.0, 0.0], DifferentialDrive(min_speed=-0.5))
    np.testing.assert_allclose(runner.act(corridor(), (0, 0, 0), PATH), [-0.5, 0.0], atol=1e-6)


def test_shield_of_a_faster_robot_is_clipped():
    bundle = load_bundle(ZOO / "navrl-best")
    robot = bundle.build("robot", max_speed=0.05)
    runner = PolicyRunner(bundle.build("transforms"), bundle.actor, bundle.build("lidar"), robot)
    ranges = np.full(BEAMS, 0.25)
    ranges[700:760] = 3.4
    for _ in range(3):
        v, w = runner.act(ranges, (0, 0, 0), PATH)
        assert 0.0 <= v <= np.float32(0.05) and abs(w) <= math.pi


@pytest.mark.parametrize("fault", ["raises", "not finite"])
def test_failed_decision_is_not_stored(fault):
    bundle = load_bundle(ZOO / "paper")
    parts = (bundle.build(part) for part in ("lidar", "robot"))
    broken = {"now": False}

    class Sometimes(torch.nn.Module):
        def forward(self, *inputs):
            if broken["now"] and fault == "raises":
                raise RuntimeError("out of memory")
            action = bundle.actor.module(*inputs)
            return action * math.nan if broken["now"] else action

    actor = TensorDictModule(Sometimes(), bundle.actor.in_keys, [keys.ACTION])
    runner = PolicyRunner(bundle.build("transforms"), actor, *parts)
    near, nearer = with_sector(1.0, -20, 20), with_sector(0.8, -30, 40)
    commands = []
    for fails in (False, True):
        runner.reset()
        runner.act(corridor(), (0, 0, 0), PATH)
        broken["now"] = fails
        if fails and fault == "raises":
            with pytest.raises(RuntimeError):
                runner.act(nearer, (0, 0, 0), PATH)
            assert runner.state is None
        elif fails:
            assert runner.act(nearer, (0, 0, 0), PATH).tolist() == [0.0, 0.0]
        broken["now"] = False
        commands.append(runner.act(near, (0, 0, 0), PATH))
    assert np.array_equal(*commands)


@pytest.mark.parametrize(
    "values",
    [
        {"goal_radius": -0.1},
        {"max_path_distance": 0.0},
        {"min_measured_share": 1.1},
        {"max_gap": math.nan},
        {"sector": 0.0},
        {"sensor_range": -1.0},
    ],
)
def test_invalid_limits_are_named(values):
    ((name, value),) = values.items()
    with pytest.raises(ValueError, match=rf"{name}={value}: must be"):
        SafetyLimits(**values)


# --- the page ------------------------------------------------------------------------------------

PAGE = pages.ROOT / "docs" / "robots.md"


def test_documented_examples_drive(capsys):
    """The runner's drives, the scan's asserts, the controller's drives, and a path is planned."""
    ends = (": drive\n", "", "drive: \n", "stale_scan has a path\n")
    for example, end in zip(pages.blocks(PAGE, "python"), ends, strict=True):
        exec(compile(example, str(PAGE), "exec"), {})
        assert capsys.readouterr().out.endswith(end)


def test_page_lists_each_state_and_limit():
    text = PAGE.read_text()
    for name in (*DriveState, *(field.name for field in dataclasses.fields(SafetyLimits))):
        assert f"`{name}`" in text
