"""The guard of an exported graph decides as the checks of the runner."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from navrl.deploy import DriveState, SafetyLimits, ScanCheck
from navrl.deploy.safety import path_state
from navrl.export.guard import STATES, Guard
from navrl.sim import DifferentialDrive, Lidar

BEAMS = 72
SPECIAL = [math.nan, math.inf, -math.inf, 0.0, -1.0, 3.5, 5.0, 150.0, 1e-3, 3.0]
PATH = np.stack([np.linspace(0.0, 4.0, 200), np.zeros(200)], axis=-1)
LIDARS = {
    "full": Lidar(BEAMS, 3.5),
    "half": Lidar(BEAMS, 3.5, field_of_view=math.pi),
    "posts": Lidar(BEAMS, 3.5, blind_sectors=[[2.0, 2.5]]),
}


def parts(name, limits=None):
    robot, limits = DifferentialDrive(), limits or SafetyLimits()
    return Guard(LIDARS[name], robot, limits), ScanCheck(LIDARS[name], robot, limits)


@pytest.mark.parametrize("name", LIDARS)
@settings(max_examples=200, deadline=None)
@given(
    fill=st.sampled_from(SPECIAL),
    start=st.integers(0, BEAMS),
    length=st.integers(0, BEAMS),
    others=st.lists(st.sampled_from([2.0, *SPECIAL]), min_size=BEAMS, max_size=BEAMS),
    is_mixed=st.booleans(),
)
def test_guard_reads_scans_as_the_scan_check(name, fill, start, length, others, is_mixed):
    guard, check = parts(name)
    scan = np.array(others if is_mixed else [2.0] * BEAMS, dtype=np.float32)
    scan[(start + np.arange(length)) % BEAMS] = fill
    rows = torch.from_numpy(scan)[None]
    assert STATES[int(guard.sensed(rows, None, None))] is check.state(scan)
    np.testing.assert_array_equal(guard.cleaned(rows)[0], check.cleaned(scan))
    np.testing.assert_array_equal(guard.usable(rows)[0], check.usable(scan))


@pytest.mark.parametrize("gap", [1, 2, 3, 4])
def test_guard_measures_gaps_as_the_scan_check(gap):
    guard, check = parts("full", SafetyLimits(max_gap=2.5 * 2.0 * math.pi / BEAMS))
    scan = np.full(BEAMS, 2.0, dtype=np.float32)
    scan[5 : 5 + gap] = np.nan
    state = STATES[int(guard.sensed(torch.from_numpy(scan)[None], None, None))]
    assert state is check.state(scan)
    assert state is (DriveState.DRIVE if gap <= 2 else DriveState.BLIND)


@pytest.mark.parametrize(
    "pose", [(0.0, 0.0, 0.0), (2.0, 1.9, 1.0), (2.0, 2.1, 1.0), (3.9, 0.0, 0.0), (3.9, 0.3, 0.0)]
)
def test_guard_places_the_robot_as_the_runner(pose):
    guard, _ = parts("full")
    pose = np.array(pose)
    ranges = torch.full((1, BEAMS), 2.0)
    state = guard.sensed(ranges, torch.from_numpy(pose)[None], torch.from_numpy(PATH)[None])
    assert STATES[int(state)] is path_state(pose, PATH, SafetyLimits())


@pytest.mark.parametrize("pose", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0, 90.0)])
def test_unusable_pose_counts_as_off_the_path(pose):
    guard, _ = parts("full")
    pose, path = torch.tensor([pose], dtype=torch.float64), torch.from_numpy(PATH)[None]
    state = guard.sensed(torch.full((1, BEAMS), 2.0), pose, path)
    assert STATES[int(state)] is DriveState.OFF_PATH


def test_command_that_is_not_finite_is_bad_and_not_stored():
    guard, _ = parts("full")
    drive = torch.zeros(3, dtype=torch.int64)
    command = torch.tensor([[0.5, 0.0], [math.nan, 0.0], [0.5, 0.0]])
    velocity = torch.tensor([[0.0, 0.0], [0.0, 0.0], [math.inf, 0.0]])
    state, stored = guard.decided(drive, command, velocity)
    assert [STATES[number] for number in state] == ["drive", "bad_command", "bad_command"]
    assert stored.tolist() == [True, False, False]
