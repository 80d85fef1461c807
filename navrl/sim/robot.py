"""Robot models: hull, command limits and motion."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product

import torch
from torch import Tensor


class RobotModel(ABC):
    """Base class of robot models with a disc-shaped hull: command limits and motion.

    Simulators, environment, runner and controllers use robots through this interface. A subclass
    implements :attr:`command_limits` and :meth:`advance`, :meth:`travel` if it can move sideways,
    and :meth:`draw` if it differs between episodes. The simulator stores the state (pose, velocity)
    and the parameters of the episode. The velocity has the components of the command.

    Attributes:
        radius: Radius of the hull, m.
        height: Height of the robot with its sensors, m; obstacles above it are not touched.
    """

    radius: float
    height: float = 0.5

    @property
    @abstractmethod
    def command_limits(self) -> tuple[Sequence[float], Sequence[float]]:
        """Smallest and largest command, C numbers each, e.g. (v, w) in m/s and rad/s."""

    def draw(self, seed: Tensor) -> Tensor:
        """Draw the parameters of episodes; P = 0 for a model that is the same in all of them.

        Args:
            seed: [M] int64, ``noise_seed`` of the scenarios.

        Returns:
            [M, P] float64 on the device of ``seed``, rows that depend on their seed only.
        """
        return torch.zeros(len(seed), 0, dtype=torch.float64, device=seed.device)

    @abstractmethod
    def advance(
        self,
        pose: Tensor,
        velocity: Tensor,
        command: Tensor,
        duration: float,
        parameters: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return pose and velocity after one substep.

        Simulators pass ``parameters`` to models with P > 0 only, so others need not accept it.

        Args:
            pose: [*B, 3] float64 (x, y, yaw), world, m and rad.
            velocity: [*B, C], velocity of the previous substep, in the components of the command.
            command: [*B, C], clipped to the limits by the model.
            duration: Duration of the substep, s.
            parameters: [*B, P] float64 of :meth:`draw`; None for the nominal base.

        Returns:
            Pose [*B, 3] and velocity [*B, C] after the substep.
        """

    def rollout(
        self,
        pose: Tensor,
        velocity: Tensor,
        commands: Tensor,
        duration: float,
        parameters: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return poses and velocities after each of S substeps; see :meth:`advance`.

        Args:
            pose: [*B, 3] float64 at the start.
            velocity: [*B, C] at the start.
            commands: [S, *B, C], command of each substep.
            duration: Duration of each substep, s.
            parameters: [*B, P] float64 of :meth:`draw`; None for the nominal base.

        Returns:
            Poses [S, *B, 3] and velocities [S, *B, C].
        """
        drawn = () if parameters is None else (parameters,)
        poses, velocities = [], []
        for command in commands:
            pose, velocity = self.advance(pose, velocity, command, duration, *drawn)
            poses.append(pose)
            velocities.append(velocity)
        return torch.stack(poses), torch.stack(velocities)

    def advance_one(
        self,
        pose: Sequence[float],
        velocity: Sequence[float],
        command: Sequence[float],
        duration: float,
        parameters: Tensor | None = None,
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return pose and velocity of one robot as numbers; see :meth:`advance`.

        Args:
            pose: (x, y, yaw), world, m and rad.
            velocity: C numbers, velocity of the previous substep.
            command: C numbers.
            duration: Duration of the substep, s.
            parameters: [P] float64 of :meth:`draw`; None for the nominal base.
        """
        rows = [torch.tensor([value], dtype=torch.float64) for value in (pose, velocity, command)]
        drawn = () if parameters is None else (parameters[None],)
        pose_after, velocity_after = self.advance(rows[0], rows[1], rows[2], duration, *drawn)
        return tuple(pose_after[0].tolist()), tuple(velocity_after[0].tolist())

    def travel(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Return the direction of travel [*B], world, rad, and the speed along it [*B], m/s.

        They classify contacts by fault: the robot is at fault on the side it moves towards.
        """
        return pose[..., 2], velocity[..., 0]

    def travel_one(self, pose: Sequence[float], velocity: Sequence[float]) -> tuple[float, float]:
        """Return direction and speed of one robot as numbers; see :meth:`travel`."""
        row = (torch.tensor(value, dtype=torch.float64) for value in (pose, velocity))
        heading, speed = self.travel(*row)
        return float(heading), float(speed)

    @property
    def top_speed(self) -> float:
        """Largest speed of travel that the command limits allow, m/s; metrics scale by it."""
        corners = torch.tensor(list(product(*zip(*self.command_limits, strict=True))))
        _, speed = self.travel(torch.zeros(len(corners), 3, dtype=torch.float64), corners.double())
        return float(speed.abs().max())

    @property
    def travel_bearings(self) -> tuple[float, ...]:
        """Bearings of motion of the single command components, rad, 0 straight ahead.

        A robot is not driven where it cannot see in one of them.
        """
        limits = torch.tensor(self.command_limits, dtype=torch.float64)
        commands = torch.cat([torch.diag(row) for row in limits])  # one component at a time
        heading, speed = self.travel(torch.zeros(len(commands), 3, dtype=torch.float64), commands)
        heading = torch.where(speed < 0, heading + math.pi, heading)
        return tuple(sorted(set(heading[speed != 0].tolist())))

    @property
    def follows_commands(self) -> bool:
        """Return whether the base has the commanded velocity at once and in full."""
        return False

    def reachable(self, velocity: Tensor, command: Tensor, duration: float) -> Tensor:
        """Return the velocity nearest to a command that accelerations allow within a time.

        Args:
            velocity: [*B, C] now.
            command: [*B, C], clipped to the limits here.
            duration: Time to accelerate, s.

        Returns:
            [*B, C]; the clipped command itself for a model without limits of acceleration.
        """
        return self.clip(command)

    @property
    def command_size(self) -> int:
        """Number C of components of a command."""
        return len(self.command_limits[0])

    def bounds(self, device: torch.device | str = "cpu") -> tuple[Tensor, Tensor]:
        """Return the smallest and the largest command, float32 [C] each."""
        low, high = self.command_limits
        return torch.tensor(low, device=device), torch.tensor(high, device=device)

    def clip(self, command: Tensor) -> Tensor:
        """Return the command [*B, C] within the limits, in its own dtype."""
        low, high = (torch.tensor(limit).to(command) for limit in self.command_limits)
        return command.clamp(low, high)
