"""The controller drives in one state only, at the policy's rate, within the deployer's limits."""

import math
import threading
import time

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule

from navrl import keys
from navrl.deploy import Controller, ControlLimits, DriveState, PolicyRunner, load_scanner
from navrl.policies import ZOO
from navrl.sim import DifferentialDrive, Lidar
from navrl.transforms import Waypoints, compose

PATH = [(0.1 * i, 0.0) for i in range(41)]  # m, straight ahead
BEAMS = 360


def corridor():
    """Ranges, m, of an A1 between two walls; beam 0 points backwards."""
    bearing = -np.pi + np.arange(BEAMS) * 2 * np.pi / BEAMS
    return np.minimum(1.5 / np.maximum(np.abs(np.sin(bearing)), 1e-9), 11.0)


class Constant(torch.nn.Module):
    """An actor that returns one action and counts its calls."""

    def __init__(self, action):
        super().__init__()
        self.action, self.calls, self.delay = action, 0, 0.0

    def forward(self, ranges):
        self.calls += 1
        time.sleep(self.delay)
        return torch.tensor([self.action])


def constant(action=(1.0, 0.0), steps=None, **limits):
    """A controller whose policy drives ahead at 1 m/s, whatever it sees."""
    actor = Constant(action)
    policy = TensorDictModule(actor, [keys.RANGES], [keys.ACTION])
    lidar, robot = Lidar(1440), DifferentialDrive()
    runner = PolicyRunner(steps or compose(), policy, lidar, robot)
    return Controller(runner, load_scanner("rplidar_a1"), ControlLimits(**limits)), actor


def feed(control, now, pose=(0.0, 0.0, 0.0), scan=None):
    control.on_odometry(now, pose, (0.0, 0.0))
    control.on_pose(now, pose)
    control.on_scan(now - 0.19, corridor() + 1e-4 * now if scan is None else scan)


@pytest.fixture
def driving():
    control, _ = constant()
    control.on_path(PATH)
    feed(control, 10.0)
    assert control.tick(10.0) == (1.0, 0.0, DriveState.DRIVE)
    return control


@pytest.fixture(scope="module")
def paper():
    return Controller.from_bundle(ZOO / "paper", "rplidar_a1", with_attention=True)


# --- states --------------------------------------------------------------------------------------


def test_drive_without_inputs_is_stopped():
    control, _ = constant()
    assert control.tick(0.0) == (0.0, 0.0, DriveState.NO_PATH)
    control.on_path(PATH)
    assert control.tick(0.1) == (0.0, 0.0, DriveState.STALE_SCAN)
    control.on_scan(0.0, corridor())
    assert control.tick(0.2) == (0.0, 0.0, DriveState.STALE_POSE)


def test_emergency_stop_has_precedence_until_its_release(driving):
    driving.emergency_stop()
    for now in (10.02, 10.2, 10.4):
        feed(driving, now)
        assert driving.tick(now) == (0.0, 0.0, DriveState.EMERGENCY_STOP)
    driving.release()
    assert driving.tick(10.4).v == 1.0


def test_command_is_not_resumed_after_a_stop(driving):
    for stop, resume in (
        (driving.emergency_stop, driving.release),
        (lambda: driving.on_path(None), lambda: driving.on_path(PATH)),
    ):
        stop()
        driving.tick(10.02)
        resume()
        assert driving.tick(10.04)[:2] == (0.0, 0.0)
    feed(driving, 10.2)
    assert driving.tick(10.2).v == 1.0


@pytest.mark.parametrize("gap", [0.02, 0.1])
def test_old_scan_stops_the_robot_at_the_timeout(driving, gap):
    ends = 10.0 - 0.19 + 0.182 + 0.5  # s: the last beam, and the timeout
    for now in np.arange(10.0 + gap, 11.0, gap):
        driving.on_pose(now, (0.0, 0.0, 0.0))
        driving.on_odometry(now, (0.0, 0.0, 0.0), (0.0, 0.0))
        v, _, state = driving.tick(now)
        expected = DriveState.DRIVE if now <= ends else DriveState.STALE_SCAN
        assert state is expected and (v > 0) == (expected is DriveState.DRIVE)


def test_old_odometry_stops_the_robot(driving):
    driving.on_scan(10.4, corridor())
    driving.on_pose(10.6, (0.0, 0.0, 0.0))
    assert driving.tick(10.6).state is DriveState.STALE_POSE


def test_old_localization_is_moved_on_by_odometry():
    control, _ = constant(steps=compose(waypoints=Waypoints()))
    control.on_path(PATH)
    control.on_pose(10.0, (1.0, 0.0, 0.0))
    control.on_odometry(10.0, (7.0, 3.0, math.pi / 2), (0.0, 0.0))  # another frame
    for now in (10.0, 10.2, 10.4, 10.6, 10.8):
        control.on_odometry(now, (7.0, 3.0 + now - 10.0, math.pi / 2), (1.0, 0.0))
        control.on_scan(now - 0.19, corridor() + 1e-4 * now)
        assert control.tick(now).state is DriveState.DRIVE
    assert control.status.pose == pytest.approx([1.8, 0.0, 0.0], abs=1e-6)
    assert control.status.progress_m == pytest.approx(1.8, abs=1e-5)
    strict, _ = constant(localization_timeout_s=0.5)
    strict.on_path(PATH)
    strict.on_pose(10.0, (1.0, 0.0, 0.0))
    strict.on_odometry(10.8, (0.0, 0.0, 0.0), (0.0, 0.0))
    strict.on_scan(10.6, corridor())
    assert strict.tick(10.8).state is DriveState.STALE_POSE


def future(control, kind, stamp):
    if kind == "scan":
        control.on_scan(stamp, corridor() + 0.01)
    elif kind == "pose":
        control.on_pose(stamp, (0.0, 0.0, 0.0))
    else:
        control.on_odometry(stamp, (0.0, 0.0, 0.0), (0.0, 0.0))


@pytest.mark.parametrize("kind", ["scan", "pose", "odometry"])
def test_one_stamp_far_ahead_stops_until_the_next_input(driving, kind):
    future(driving, kind, 1010.2)
    state = DriveState.STALE_SCAN if kind == "scan" else DriveState.STALE_POSE
    assert driving.tick(10.1) == (0.0, 0.0, state)
    assert driving.status.reason == f"{kind} stamped 1000.10 s in the future"
    feed(driving, 10.2)
    assert driving.tick(10.2).v == 1.0


@pytest.mark.parametrize("pause", [1.01, 3600.0])
def test_robot_drives_on_after_a_pause_of_the_loop(driving, pause):
    now = 10.0 + pause
    feed(driving, now)
    assert driving.tick(now).v == 1.0


@pytest.mark.parametrize("kind", ["scan", "pose", "odometry"])
@pytest.mark.parametrize("ahead", [0.6, 1000.0])
def test_future_stamp_before_a_tick_is_dropped_there(kind, ahead):
    control, _ = constant()
    control.on_path(PATH)
    feed(control, 9.9)
    future(control, kind, 10.0 + ahead)
    assert control.tick(10.0)[:2] == (0.0, 0.0)
    assert f"{kind} stamped {ahead:.2f} s in the future" in control.status.reason
    feed(control, 10.2)
    assert control.tick(10.2).v == 1.0


def test_jump_of_all_clocks_stops_for_at_most_one_tick(driving):
    feed(driving, 70.0)
    assert driving.tick(70.0).v == 1.0
    assert driving.tick(10.4)[:2] == (0.0, 0.0)  # and back
    feed(driving, 10.6)
    assert driving.tick(10.6).v == 1.0


def test_invalid_odometry_stops_at_once_and_retains_motion(driving):
    with pytest.raises(ValueError, match="velocity="):
        driving.on_odometry(10.05, (0.0, 0.0, 0.0), (math.nan, 0.0))
    assert driving.tick(10.05) == (0.0, 0.0, DriveState.STALE_POSE)
    assert driving.status.reason.startswith("odometry refused: velocity=[nan, 0.0]")
    driving.on_pose(10.1, (0.0, 0.0, 0.0))
    assert driving.tick(10.1).state is DriveState.STALE_POSE
    driving.on_odometry(10.2, (0.5, 0.0, 0.0), (0.0, 0.0))
    driving.on_scan(10.01, corridor() + 0.01)
    assert driving.tick(10.2).v == 1.0
    assert driving.status.pose[0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("scan", "pose", "state"),
    [
        (np.full(BEAMS, np.nan), (0, 0, 0), DriveState.BLIND),
        (np.full(BEAMS, np.inf), (0, 0, 0), DriveState.BLIND),
        (np.where(np.arange(BEAMS) == 180, -np.inf, 2.0), (0, 0, 0), DriveState.BLOCKED),
        (None, (0, 5, 0), DriveState.OFF_PATH),
        (None, (4, 0, 0), DriveState.AT_GOAL),
    ],
)
def test_states_of_the_runner_command_zero(driving, scan, pose, state):
    feed(driving, 10.2, pose, scan)
    for now in (10.2, 10.25, 10.3):
        assert driving.tick(now) == (0.0, 0.0, state)


def test_failing_policy_stops_the_robot(driving, caplog):
    driving.runner._act._actor.module.forward = lambda ranges: 1 / 0
    feed(driving, 10.2)
    assert driving.tick(10.2) == (0.0, 0.0, DriveState.BAD_COMMAND)
    assert "ZeroDivisionError" in driving.status.reason


def test_goal_is_final_until_a_new_path(driving):
    feed(driving, 10.2, (3.9, 0.0, 0.0))
    assert driving.tick(10.2).state is DriveState.AT_GOAL
    feed(driving, 10.4, (3.5, 0.0, 0.0))
    assert driving.tick(10.4).state is DriveState.AT_GOAL
    driving.on_path([(3.0, 0.0), (0.0, 0.0)])
    feed(driving, 10.6, (3.5, 0.0, 0.0))
    assert driving.tick(10.6).state is DriveState.DRIVE


def test_cancelled_path_stops_the_robot(driving):
    driving.on_path(None)
    assert driving.tick(10.05) == (0.0, 0.0, DriveState.NO_PATH)


def test_repeated_scan_of_a_moving_robot_is_blind():
    """The driver repeats one scan with new stamps."""
    control, _ = constant()
    control.on_path(PATH)
    states = []
    for step in range(8):
        now = 10.0 + 0.2 * step
        feed(control, now, (0.05 * step, 0.0, 0.0), corridor())
        states.append(control.tick(now).state)
    assert states[0] is DriveState.DRIVE and states[-1] is DriveState.BLIND
    assert "repeats one scan" in control.status.reason
    for step in range(8, 12):  # and standing
        feed(control, 10.0 + 0.2 * step, (0.35, 0.0, 0.0), corridor() + 0.001 * (step == 8))
        control.tick(10.0 + 0.2 * step)
    assert control.status.state is DriveState.DRIVE


# --- time ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "steps"), [(5.0, 11), (10.0, 11), (20.0, 11), (40.0, 13)])
def test_policy_decides_once_per_time_step(rate, steps):
    control, actor = constant()
    control.on_path(PATH)
    for index in range(int(2 * rate) + 1):
        now = 10.0 + index / rate
        feed(control, now, scan=corridor() + 0.001 * index)
        assert control.tick(now).v == 1.0
    assert actor.calls == control.status.num_steps
    assert steps - 2 <= actor.calls <= steps
    assert control.status.num_resets == 0


@pytest.mark.parametrize(("gap", "resets"), [(0.4, 0), (0.5, 1), (60.0, 1)])
def test_gap_between_scans_restarts_the_history(paper, gap, resets):
    control = Controller(paper.runner, load_scanner("rplidar_a1"))
    control.runner.reset()
    control.on_path(PATH)
    for now in (10.0, 10.2, 10.2 + gap):
        control.tick(now)  # the time is known before a stamp of it
        feed(control, now, (now - 10.0, 0.0, 0.0) if gap < 1 else (1.0, 0.0, 0.0))
        control.tick(now)
    assert control.status.num_resets == resets
    points = control.runner.observation
    is_first = torch.equal(points[keys.PREVIOUS_POINTS], points[keys.POINTS])
    assert is_first == bool(resets)
    assert control.status.progress_m > 0.3  # which is retained


def test_older_and_repeated_stamps_are_ignored(driving):
    driving.on_scan(9.81, np.full(BEAMS, 0.2))
    driving.on_scan(5.0, np.full(BEAMS, 0.2))
    driving.on_odometry(9.0, (9.0, 9.0, 0.0), (0.0, 0.0))
    driving.on_pose(9.0, (9.0, 9.0, 0.0))
    assert driving.tick(10.05).v == 1.0
    assert driving.status.num_rejected == 4


def test_clock_that_restarts_drops_old_inputs(driving):
    assert driving.tick(0.0) == (0.0, 0.0, DriveState.STALE_SCAN)
    feed(driving, 0.2)
    assert driving.tick(0.2).v == 1.0


@pytest.mark.parametrize("now", [math.nan, math.inf])
def test_invalid_time_commands_zero(driving, now):
    assert driving.tick(now)[:2] == (0.0, 0.0)


# --- paths ---------------------------------------------------------------------------------------


def test_new_path_retains_the_scans_and_restarts_progress(paper):
    control = Controller(paper.runner, load_scanner("rplidar_a1"))
    control.runner.reset()
    control.on_path(PATH)
    for step in range(4):
        feed(control, 10.0 + 0.2 * step, (0.3 * step, 0.0, 0.0), corridor() + 0.01 * step)
        control.tick(10.0 + 0.2 * step)
    assert control.status.progress_m == pytest.approx(0.9, abs=0.01)
    control.on_path(PATH[9:])
    feed(control, 10.8, (1.2, 0.0, 0.0), corridor())
    assert control.tick(10.8).state is DriveState.DRIVE
    points = control.runner.observation
    assert not torch.equal(points[keys.PREVIOUS_POINTS], points[keys.POINTS])
    assert control.status.progress_m == pytest.approx(0.3, abs=0.01)


def test_new_path_between_scans_does_not_interrupt_the_drive(driving):
    driving.on_path(PATH[1:])
    assert driving.tick(10.05) == (1.0, 0.0, DriveState.DRIVE)


@pytest.mark.parametrize("is_first", [True, False])
def test_path_that_passes_its_start_begins_on_the_first_branch(is_first):
    corners = np.array([(0, 0), (3, 0), (3, 3), (0, 3), (0, -2)], float)
    loop = np.concatenate(
        [np.linspace(a, b, 30, endpoint=False) for a, b in zip(corners, corners[1:], strict=False)]
    )
    control, _ = constant(steps=compose(waypoints=Waypoints()))
    if not is_first:
        control.on_path(PATH)
        feed(control, 10.0)
        control.tick(10.0)
    control.on_path([*loop, (0.0, -2.0)])
    feed(control, 10.2, (0.02, 0.01, 0.0), corridor() + 0.01)
    control.tick(10.2)
    assert control.status.progress_m == pytest.approx(0.02, abs=0.02)


@pytest.mark.parametrize("count", [1, 2, 200, 201, 301, 5000])
def test_path_of_any_length_is_accepted(count):
    control, _ = constant()
    angle = np.linspace(0.0, np.pi, count) if count > 1 else np.zeros(1)
    control.on_path(np.stack([3 * np.sin(angle), 3 - 3 * np.cos(angle)], -1) + 1.0)
    feed(control, 10.0, (1.0, 1.0, 0.0))
    state = control.tick(10.0).state
    assert state is (DriveState.DRIVE if count > 1 else DriveState.AT_GOAL)
    path = control._inputs.path
    assert len(path) <= 200
    radius = np.hypot(path[:, 0] - 1.0, path[:, 1] - 4.0)
    assert count == 1 or np.abs(radius - 3.0).max() < 1e-6


@pytest.mark.parametrize("path", [[], [(0, 0, 0)], [(0, 0), (np.nan, 1)]])
def test_invalid_path_is_rejected_and_stops(driving, path):
    with pytest.raises(ValueError, match="path"):
        driving.on_path(path)
    assert driving.tick(10.05) == (0.0, 0.0, DriveState.NO_PATH)


# --- limits --------------------------------------------------------------------------------------


def test_speed_limits_retain_the_arc():
    control, _ = constant((1.0, 0.5), max_speed=0.5)
    control.on_path(PATH)
    feed(control, 10.0)
    v, w, _ = control.tick(10.0)
    assert (v, w) == pytest.approx((0.5, 0.25 * math.pi))
    slow, _ = constant((1.0, 0.5), speed_scale=0.3)
    slow.on_path(PATH)
    feed(slow, 10.0)
    assert slow.tick(10.0)[:2] == pytest.approx((0.3, 0.15 * math.pi))


def test_acceleration_is_limited_between_ticks_but_stops_are_not():
    control, _ = constant(linear_acceleration=1.0, max_step_s=0.4)
    control.on_path(PATH)
    control.tick(9.95)
    speeds = []
    for now in (10.0, 10.05, 10.1, 10.2):
        feed(control, now)
        speeds.append(control.tick(now).v)
    assert speeds == pytest.approx([0.05, 0.1, 0.15, 0.25])
    control.emergency_stop()
    assert control.tick(10.21).v == 0.0


@pytest.mark.parametrize("name", ["scan_timeout_s", "speed_scale", "max_speed", "max_step_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_limits_must_be_positive(name, value):
    with pytest.raises(ValueError, match=rf"{name}={value}: must be"):
        ControlLimits(**{name: value})
    with pytest.raises(ValueError, match=r"speed_scale=1\.5"):
        ControlLimits(speed_scale=1.5)


# --- the status, threads and the start -----------------------------------------------------------


def test_status_reports_the_inputs_of_the_policy(paper):
    control = Controller(paper.runner, load_scanner("rplidar_a1"))
    control.runner.reset()
    control.on_path(PATH)
    for now in (10.0, 10.2):
        feed(control, now)
        control.tick(now)
    status = control.status
    assert status.state is DriveState.DRIVE and status.num_steps == 2
    assert status.points.shape == (180, 2) and status.returns.shape == (180,)
    assert status.tagd.shape == (30, 4) and status.tagd_valid.shape == (30, 2)
    for weights in (status.spatial_attention, status.temporal_attention):
        assert weights.sum() == pytest.approx(1.0, abs=1e-5)
    assert status.icp_converged and status.icp_inliers > 10
    assert status.icp_transform == pytest.approx([0.0, 0.0, 0.0], abs=0.02)
    assert status.goal_distance_m == pytest.approx(4.0)
    assert status.scan_age_s == pytest.approx(0.008)


def test_warm_up_leaves_no_trace():
    control = Controller.from_bundle(ZOO / "paper", "utm_30lx")
    control.warm_up(1)
    assert control.runner.observation is None and control.tick(0.0).state is DriveState.NO_PATH


def test_scan_is_moved_to_the_time_of_the_tick():
    """A wall 2 m ahead of a robot that has driven 0.4 m since the scan."""
    bearing = -np.pi + np.arange(BEAMS) * 2 * np.pi / BEAMS
    wall = np.where(np.abs(bearing) < 1.2, 2.0 / np.cos(bearing).clip(0.2), 11.0)
    nearest = []
    for moves in (True, False):
        control, _ = constant()
        control.compensate_motion = moves
        control.on_path(PATH)
        control.on_pose(9.4, (0.0, 0.0, 0.0))
        for now in np.arange(9.4, 10.01, 0.1):
            control.on_odometry(now, (now - 9.4, 0.0, 0.0), (1.0, 0.0))
        control.on_scan(9.6, wall, duration_s=0.0)
        control.tick(10.0)
        nearest.append(float(control.runner.observation["ranges"][0, 0]))
    assert nearest == pytest.approx([1.6, 2.0], abs=0.01)


def test_inputs_do_not_wait_for_a_decision():
    control, actor = constant()
    control.on_path(PATH)
    feed(control, 10.0)
    actor.delay = 0.5
    commands = []
    thread = threading.Thread(target=lambda: commands.append(control.tick(10.0)))
    thread.start()
    while not actor.calls:
        time.sleep(0.001)
    start = time.perf_counter()
    control.on_odometry(10.1, (0.0, 0.0, 0.0), (0.0, 0.0))
    control.emergency_stop()
    assert time.perf_counter() - start < 0.2
    thread.join()
    assert commands == [(0.0, 0.0, DriveState.EMERGENCY_STOP)]  # although it had begun before


def test_threads_may_call_every_method():
    control, _ = constant()
    control.on_path(PATH)
    errors, done, clock = [], threading.Event(), [10.0]

    def repeat(call):
        try:
            while not done.is_set():
                call()
        except Exception as error:
            errors.append(error)

    calls = [
        lambda: feed(control, clock[0]),
        lambda: control.on_path(PATH),
        lambda: control.status,
        lambda: (control.emergency_stop(), control.release()),
        lambda: control.tick(clock[0]),
    ]
    threads = [threading.Thread(target=repeat, args=(call,)) for call in calls]
    for thread in threads:
        thread.start()
    for _ in range(40):
        clock[0] += 0.05
        v, _, state = control.tick(clock[0])
        assert (v > 0) <= (state is DriveState.DRIVE)
        time.sleep(0.002)
    done.set()
    for thread in threads:
        thread.join()
    assert not errors
