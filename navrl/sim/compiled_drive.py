"""Robots that the kernels move, instead of their torch code."""

from __future__ import annotations

import math
from typing import TypeGuard

from navrl.sim.differential_drive import DifferentialDrive
from navrl.sim.robot import RobotModel


def is_compiled(robot: RobotModel) -> TypeGuard[DifferentialDrive]:
    """Return whether the kernel moves the robot, rather than its own torch code."""
    return isinstance(robot, DifferentialDrive) and robot.is_compiled


def drive_parameters(robot: RobotModel) -> tuple:
    """Return the ``drive`` argument of the kernel for a differential drive or another model."""
    if not is_compiled(robot):
        return (robot.radius, True, 1.0, math.inf, 0.0, 0.0, 0.0)
    return (
        robot.radius,
        False,
        robot.wheel_separation,
        robot.acceleration_limit,
        robot.min_speed,
        robot.max_speed,
        robot.max_turn_rate,
    )
