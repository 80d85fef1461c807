"""Arguments out of range are refused by name, with the value and what is allowed."""

import math
import re

import numpy as np
import pytest

from navrl.checks import check_pose, check_positive
from navrl.policies.classical import DynamicWindow, Oracle, Orca
from navrl.sim import BatchedSimulator, BulletSimulator, DifferentialDrive, Lidar
from navrl.training import Schedule
from navrl.transforms import TAGD, MinPool, RangeHistory, Waypoints

ROBOT = DifferentialDrive()


def batched(**values):
    return BatchedSimulator(**{"num_worlds": 1, "robot": ROBOT, "lidar": Lidar()} | values)


def bullet(**values):
    return BulletSimulator(**{"num_worlds": 1, "robot": ROBOT, "lidar": Lidar()} | values)


@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize(
    "make, name",
    [
        *((make, name) for make in (batched, bullet) for name in ("num_worlds", "time_step_s")),
        *((make, name) for make in (batched, bullet) for name in ("substeps", "max_pedestrians")),
        (batched, "max_walls"),
        (DifferentialDrive, "radius"),
        (DifferentialDrive, "wheel_acceleration"),
        (Lidar, "max_range"),
        (Lidar, "height"),
        *((Orca, name) for name in ("time_step_s", "time_horizon", "wall_horizon", "iterations")),
        *((Oracle, name) for name in ("goal_radius", "time_limit_steps", "time_step_s")),
        *((Oracle, name) for name in ("substeps", "cell")),
        *((DynamicWindow, name) for name in ("time_step_s", "horizon_steps", "clearance")),
        (DynamicWindow, "group_radius"),
    ],
)
def test_arguments_must_be_positive_and_finite(make, name, value):
    robot = {"robot": ROBOT} if make in (Orca, Oracle, DynamicWindow) else {}
    with pytest.raises(ValueError, match=rf"^{name}={re.escape(str(value))}: must be positive"):
        make(**robot, **{name: value})


@pytest.mark.parametrize("value", [0, 7.5, 8.0, math.nan, True, "8"])
@pytest.mark.parametrize(
    "make, name",
    [
        *((MinPool, name) for name in ("group_size", "num_points")),
        *((RangeHistory, name) for name in ("num_scans", "group_size")),
        (TAGD, "num_groups"),
        (Waypoints, "num_waypoints"),
        *((Schedule, f"{name}_every_updates") for name in ("evaluate", "log")),
        (Schedule, "total_frames"),
    ],
)
def test_counts_must_be_positive_integers(make, name, value):
    with pytest.raises(ValueError, match=rf"^{name}={value!r}: must be an integer, at least 1$"):
        make(**{name: value})


def test_numpy_counts_are_accepted():
    assert MinPool(group_size=np.int64(4)).group_size == 4


@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize(
    "make, name",
    [
        (MinPool, "max_range"),
        (RangeHistory, "max_range"),
        *((TAGD, name) for name in ("group_radius", "max_range")),
        (Waypoints, "spacing"),
        (Schedule, "frames_per_update"),
    ],
)
def test_lengths_and_rates_must_be_positive_and_finite(make, name, value):
    with pytest.raises(ValueError, match=rf"^{name}={re.escape(str(value))}: must be positive"):
        make(**{name: value})


@pytest.mark.parametrize(
    "name, value",
    [("learning_starts", -1), ("learning_starts", math.nan)]
    + [("checkpoint_every_s", value) for value in (0.0, math.nan)],
)
def test_start_and_interval_of_the_schedule_are_checked(name, value):
    with pytest.raises(ValueError, match=f"^{name}={value}: must be >"):
        Schedule(**{name: value})
    assert Schedule(checkpoint_every_s=math.inf, learning_starts=0).learning_starts == 0


def test_first_wrong_argument_is_named():
    check_positive(a=1, b=0.5)
    with pytest.raises(ValueError, match=r"^b=-0.5: must be positive and finite$"):
        check_positive(a=1, b=-0.5, c=0)


def test_pose_may_be_an_array():
    check_pose("mount", np.array([0.1, 0.0, 3.0]))
    for pose in (None, "abc", [0.0, 0.0], [0.0, 0.0, np.nan], [0.0, 0.0, 180.0]):
        with pytest.raises(ValueError, match="mount="):
            check_pose("mount", pose)
