"""Maneuvers of a base that needs time: motion of one step between the velocities of a grid."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navrl.sim import RobotModel

_MAX_LEVELS = (10, 4)  # velocities of a component in one direction, more only if it is slower
_SETTLING_STEPS = 100  # steps after which the largest velocity is measured
_SLACK = 0.1  # share of the limit that a lag leaves unused
_TOLERANCE = 1e-7  # m/s and rad/s


class Maneuvers(NamedTuple):
    """Table of maneuvers; V velocities, A maneuvers of each, U substeps.

    Args:
        velocities: ``[V, 2]`` (v, w), m/s and rad/s.
        commands: ``[V, A, 2]`` (v, w) of each maneuver.
        following: ``[V, A]`` int64, index of the velocity after the step; -1 for no maneuver.
        offsets: ``[V, A, U, 3]`` (x, y, yaw) after each substep, from pose 0; m and rad.
    """

    velocities: Tensor
    commands: Tensor
    following: Tensor
    offsets: Tensor

    @property
    def rest(self) -> int:
        """Index of the velocity zero."""
        return int((self.velocities == 0).all(-1).nonzero()[0])


def maneuvers(robot: RobotModel, time_step_s: float, substeps: int) -> Maneuvers:
    """Return all maneuvers of one step between the velocities of a grid.

    The motion is that of :meth:`navrl.sim.RobotModel.rollout` with the nominal base. The commands
    are those with which the velocity at the end of the step is exactly one of the grid.

    Args:
        robot: Base with commands (v, w).
        time_step_s: Duration of a step, s.
        substeps: Substeps per step.

    Returns:
        Maneuvers in the order of preference: fast and straight ones first.
    """
    velocities = _grid(robot, time_step_s, substeps)
    count = len(velocities)
    start = velocities[:, None].expand(count, count, 2).reshape(-1, 2)
    target = velocities[None].expand(count, count, 2).reshape(-1, 2)
    commands = _commands(robot, start, target, time_step_s, substeps)
    poses, reached = _roll(robot, start, commands, time_step_s, substeps)
    is_reached = ((reached[-1] - target).abs() < _TOLERANCE).all(-1).view(count, count)
    actions = int(is_reached.sum(1).max())
    # A stable sort puts the reachable ones first; the grid is in the order of preference.
    order = (~is_reached).to(torch.int8).sort(dim=1, stable=True).indices[:, :actions]
    following = order.masked_fill(~is_reached.gather(1, order), -1)
    rows = torch.arange(count)[:, None] * count + order
    return Maneuvers(
        velocities, commands[rows], following, poses[:, rows].permute(1, 2, 0, 3).contiguous()
    )


def _roll(
    robot: RobotModel, start: Tensor, command: Tensor, time_step_s: float, substeps: int
) -> tuple[Tensor, Tensor]:
    """Return poses ``[U, R, 3]`` and velocities ``[U, R, 2]`` of a step from pose 0."""
    pose = start.new_zeros(len(start), 3)
    duration = time_step_s / substeps
    return robot.rollout(pose, start, command.expand(substeps, *command.shape), duration)


def _grid(robot: RobotModel, time_step_s: float, substeps: int) -> Tensor:
    """Return the velocities ``[V, 2]``, fast and straight ones first.

    The distance of neighbors is at most the change in a step, up or down.
    """
    still = torch.zeros(2, 2, dtype=torch.float64)
    full = torch.diag(torch.tensor(robot.command_limits[1], dtype=torch.float64))
    largest = still
    for _ in range(_SETTLING_STEPS):
        largest = _roll(robot, largest, full, time_step_s, substeps)[1][-1]
    up = _roll(robot, still, full, time_step_s, substeps)[1][-1]
    down = largest - _roll(robot, largest, still, time_step_s, substeps)[1][-1]
    levels = []
    for axis in range(2):
        high = float(largest[axis, axis])
        change = min(float(up[axis, axis]), float(down[axis, axis]))
        share = _left(robot, axis, high, change, time_step_s, substeps)
        if share > _TOLERANCE:  # a lag: the limit itself is never reached
            high *= 1.0 - _SLACK
            change = min(change, _SLACK * high * (1.0 - share) / share)
        needed = math.ceil(high / change - 1e-9)
        count = max(needed, min(_MAX_LEVELS[axis], math.ceil(2 * high / change - 1e-9)))
        levels.append(torch.linspace(0.0, high, count + 1, dtype=torch.float64))
    speeds = levels[0].flip(0)
    turns = torch.stack((levels[1], -levels[1]), dim=1).flatten()[1:]  # 0, 1, -1, 2, -2
    return torch.cartesian_prod(speeds, turns)


def _left(
    robot: RobotModel, axis: int, high: float, change: float, time_step_s: float, substeps: int
) -> float:
    """Return the share of a small difference to the largest velocity that a step leaves."""
    start, command = torch.zeros(2, 1, 2, dtype=torch.float64)
    start[0, axis] = high - 0.1 * change
    command[0, axis] = robot.command_limits[1][axis]
    reached = float(_roll(robot, start, command, time_step_s, substeps)[1][-1, 0, axis])
    return (high - reached) / (0.1 * change)


def _commands(
    robot: RobotModel, start: Tensor, target: Tensor, time_step_s: float, substeps: int
) -> Tensor:
    """Return commands ``[R, 2]`` after which the velocities are the targets, if there are any.

    Newton's method per component; exact in one iteration for scale, bias and lag. Where a limit
    prevents the target the result is any command.
    """
    command, probe = target.clone(), 1e-3
    for _ in range(3):
        reached = _roll(robot, start, command, time_step_s, substeps)[1][-1]
        wrong = target - reached
        inner = torch.where(command > 0, -probe, probe)  # towards zero, within the limits
        moved = _roll(robot, start, command + inner, time_step_s, substeps)[1][-1]
        gain = (moved - reached) / inner
        is_used = (wrong.abs() > 1e-10) & (gain > 0.05)
        command = torch.where(is_used, command + wrong / gain.clamp_min(0.05), command)
        command = robot.clip(command)
    return command
