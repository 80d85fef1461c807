"""Prediction of a base's motion for commands, with its limits and delays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, cast

import torch
from torch import Tensor
from torchrl.envs import Transform

from navrl.ops.unicycle import advance_poses

_CHECK_SUBSTEP_S = 0.05  # for many commands
_AHEAD_SUBSTEP_S = 0.02  # for the one under way, as in the simulators
_TOLERANCE = 1e-6  # steps


class Drive(Protocol):
    """The part of :class:`navrl.sim.RobotModel` that a prediction needs."""

    @property
    def follows_commands(self) -> bool:
        """Return whether the base has the commanded velocity at once."""
        ...

    def rollout(
        self, pose: Tensor, velocity: Tensor, commands: Tensor, duration: float
    ) -> tuple[Tensor, Tensor]:
        """Return poses and velocities after each of S substeps."""
        ...

    def reachable(self, velocity: Tensor, command: Tensor, duration: float) -> Tensor:
        """Return the velocity nearest to a command that accelerations allow within a time."""
        ...


@dataclass(frozen=True)
class Base:
    """A base as a shield knows it: how it moves, and how old commands and scans are.

    Args:
        robot: Model of the motion, e.g. a :class:`navrl.sim.RobotModel`; of one with distributions
            the nominal base is used.
        command_delays_s: Delays of the speed and of the turn rate, s.
        scan_age_s: Age of a scan, s, during which pedestrians have moved on.

    Example:
        >>> from navrl.sim import DifferentialDrive
        >>> base = Base(DifferentialDrive(), command_delays_s=(0.2, 0.2))
        >>> given = torch.tensor([[[0.5, 0.0]]])  # the last command takes effect now
        >>> frame, velocity = base.ahead(torch.tensor([[0.5, 0.0]]), given, step=0.2)
        >>> frame.round(decimals=3)
        tensor([[0.1000, 0.0000, 0.0000]])
    """

    robot: Drive
    command_delays_s: tuple[float, float] = (0.0, 0.0)
    scan_age_s: float = 0.0

    @property
    def is_ideal(self) -> bool:
        """Return whether commands take effect at once and in full."""
        return self.robot.follows_commands and not any(self.command_delays_s)

    def when_commands_apply(self) -> Base:
        """Return the base as seen from the time at which a command given now takes effect."""
        return Base(self.robot, scan_age_s=self.scan_age_s + max(self.command_delays_s))

    def places(
        self, commands: Tensor, velocity: Tensor, given: Tensor, times: Sequence[float], step: float
    ) -> Tensor:
        """Return where the base is at times from now, if it is given a command now.

        Args:
            commands: ``[N, S, 2]`` (v, w), the command given now, m/s and rad/s.
            velocity: ``[N, 2]`` (v, w) now.
            given: ``[N, D, 2]``, commands of the last D steps, latest first.
            times: T multiples of the first one, s.
            step: Time between two commands, s.

        Returns:
            ``[N, S, T, 2]`` m, robot frame now.
        """
        if self.is_ideal:
            driven = torch.stack([commands * time for time in times], dim=-2)
            return advance_poses(commands.new_zeros(3), driven, 1.0)[..., :2]
        per_check = math.ceil(times[0] / _CHECK_SUBSTEP_S - _TOLERANCE)
        duration = times[0] / per_check
        rows = [
            self._active(commands, given, index * duration, step)
            for index in range(per_check * len(times))
        ]
        start = commands.new_zeros(*commands.shape[:-1], 3)
        now = velocity.to(commands).unsqueeze(1).expand_as(commands)
        poses, _ = self.robot.rollout(start, now, torch.stack(rows), duration)
        return poses[per_check - 1 :: per_check, ..., :2].movedim(0, -2)

    def ahead(self, velocity: Tensor, given: Tensor, step: float) -> tuple[Tensor, Tensor]:
        """Return where the base is and how it moves when a command given now takes effect.

        Args:
            velocity: ``[N, C]`` now, e.g. (v, w), m/s and rad/s.
            given: ``[N, D, C]``, commands of the last D steps, latest first.
            step: Time between two commands, s.

        Returns:
            Frame ``[N, 3]`` (x, y, yaw) in the present frame, m and rad, and velocity ``[N, C]``.
        """
        start = velocity.new_zeros(velocity.shape[0], 3)
        delay = max(self.command_delays_s)
        if delay == 0.0:
            return start, velocity
        count = math.ceil(delay / _AHEAD_SUBSTEP_S - _TOLERANCE)
        latest, duration = given[:, :1], delay / count
        rows = [self._active(latest, given, k * duration, step)[:, 0] for k in range(count)]
        poses, velocities = self.robot.rollout(start, velocity, torch.stack(rows), duration)
        return poses[-1], velocities[-1]

    def _active(self, commands: Tensor, given: Tensor, time: float, step: float) -> Tensor:
        """Return the commands ``[N, S, 2]`` that apply ``time`` seconds from now."""
        parts = []
        for axis, delay in enumerate(self.command_delays_s):
            late = math.ceil((delay - time) / step - _TOLERANCE)  # 0: the command given now
            row = commands
            if late > 0:
                row = given[:, min(late, given.shape[1]) - 1, None].expand_as(commands)
            parts.append(row[..., axis])
        return torch.stack(parts, dim=-1)


def base_of(transform: Transform) -> Base:
    """Return the base of the environment or runner that a transform is a part of.

    Raises:
        ValueError: If it is part of none that knows its base.
    """
    env = transform.container
    while env is not None and not hasattr(env, "base"):
        env = env.container if isinstance(env, Transform) else getattr(env, "base_env", None)
    if env is None:
        raise ValueError(
            "base='environment': must be part of an environment or runner that knows its base; "
            "pass a navrl.transforms.Base otherwise"
        )
    return cast(Base, env.base)


class _Kinematic:
    """A base that has the commanded velocity at once."""

    follows_commands = True

    def rollout(
        self, pose: Tensor, velocity: Tensor, commands: Tensor, duration: float
    ) -> tuple[Tensor, Tensor]:
        poses = []
        for command in commands:
            pose = advance_poses(pose, command, duration)
            poses.append(pose)
        return torch.stack(poses), commands

    def reachable(self, velocity: Tensor, command: Tensor, duration: float) -> Tensor:
        return command


IDEAL = Base(_Kinematic())
"""A base without delays that has the commanded velocity at once."""
