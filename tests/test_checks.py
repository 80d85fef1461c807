"""Arguments out of range are refused by name, with the value and what is allowed."""

import math
import re

import pytest

from navrl.checks import check_positive
from navrl.policies.classical import DynamicWindow, Oracle, Orca
from navrl.sim import BatchedSimulator, BulletSimulator, DifferentialDrive, Lidar

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


def test_first_wrong_argument_is_named():
    check_positive(a=1, b=0.5)
    with pytest.raises(ValueError, match=r"^b=-0.5: must be positive and finite$"):
        check_positive(a=1, b=-0.5, c=0)
