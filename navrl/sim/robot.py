"""Robot models: hull, command limits and motion."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import product

import torch
from torch import Tensor

from navrl.checks import check_positive
from navrl.ops.unicycle import advance_pose, advance_poses, approach_velocity

MODELS = ("kinematic", "wheeled")


class RobotModel(ABC):
    """Base class of robot models with a disc-shaped hull: command limits and motion.

    Simulators, environment, runner and controllers use robots through this interface. A subclass
    implements :attr:`command_limits` and :meth:`advance`, :meth:`travel` if it can move sideways,
    and :meth:`draw` if it differs between episodes. The simulator stores the state (pose, velocity)
    and the parameters of the episode. The velocity has the components of the command.

    Attributes:
        radius: Radius of the hull, m.
    """

    radius: float

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


class DifferentialDrive(RobotModel):
    """Differential drive with a disc-shaped hull, commanded by (v, w).

    The ``kinematic`` model follows a command immediately, as in the paper's simulation. In the
    ``wheeled`` model the wheel speeds approach those of the command by at most
    ``wheel_acceleration`` times the duration, as the controller of a real base does. Both move on
    exact circular arcs. The state is (pose, wheel speeds); the object only holds parameters.

    Args:
        radius: Radius of the hull, m.
        wheel_separation: Distance between the contact points of the wheels, m.
        max_speed: Largest forward speed, m/s.
        max_turn_rate: Largest turn rate to either side, rad/s.
        min_speed: Smallest forward speed, m/s; negative values allow reverse motion.
        model: ``kinematic`` or ``wheeled``.
        wheel_acceleration: Largest acceleration of each wheel's rim, m/s^2; for ``wheeled`` only.

    Raises:
        ValueError: If a value is out of range.

    Reference:
        Paper Sec. IV-A: v in [0, 1] m/s, w in [-pi, pi] rad/s, no acceleration limits.
    """

    def __init__(
        self,
        radius: float = 0.178,
        wheel_separation: float = 0.23,
        max_speed: float = 1.0,
        max_turn_rate: float = math.pi,
        min_speed: float = 0.0,
        model: str = "kinematic",
        wheel_acceleration: float = 2.0,
    ) -> None:
        check_positive(
            radius=radius,
            wheel_separation=wheel_separation,
            max_speed=max_speed,
            max_turn_rate=max_turn_rate,
            wheel_acceleration=wheel_acceleration,
        )
        if not -math.inf < min_speed < max_speed:
            raise ValueError(
                f"min_speed={min_speed}: must be finite and less than max_speed={max_speed}"
            )
        if model not in MODELS:
            raise ValueError(f"model={model!r}: must be one of {', '.join(MODELS)}")
        self.radius = float(radius)
        self.wheel_separation = float(wheel_separation)
        self.max_speed = float(max_speed)
        self.max_turn_rate = float(max_turn_rate)
        self.min_speed = float(min_speed)
        self.model = model
        self.wheel_acceleration = float(wheel_acceleration)

    @property
    def follows_commands(self) -> bool:
        """Return whether the model is kinematic."""
        return self.model == "kinematic" and self.is_compiled

    @property
    def is_compiled(self) -> bool:
        """Return whether the batched simulator's kernel moves it, unless a subclass does."""
        return type(self).advance is DifferentialDrive.advance

    @property
    def top_speed(self) -> float:
        """Largest forward speed, m/s."""
        return self.max_speed

    @property
    def acceleration_limit(self) -> float:
        """Largest acceleration of a wheel's rim, m/s^2; infinite for the kinematic model."""
        return self.wheel_acceleration if self.model == "wheeled" else math.inf

    @property
    def command_limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest and largest command, each (v, w) in m/s and rad/s."""
        return (self.min_speed, -self.max_turn_rate), (self.max_speed, self.max_turn_rate)

    def wheel_speeds(self, velocity: Tensor) -> Tensor:
        """Return the rim speeds [*B, 2] (left, right), m/s, of a hull moving at (v, w) [*B, 2]."""
        v, w = velocity.unbind(-1)
        half = 0.5 * self.wheel_separation * w
        return torch.stack((v - half, v + half), dim=-1)

    def velocity(self, wheel_speeds: Tensor) -> Tensor:
        """Return the hull's (v, w) [*B, 2] for rim speeds [*B, 2] (left, right), m/s."""
        left, right = wheel_speeds.unbind(-1)
        return torch.stack((0.5 * (left + right), (right - left) / self.wheel_separation), dim=-1)

    def advance(
        self,
        pose: Tensor,
        velocity: Tensor,
        command: Tensor,
        duration: float,
        parameters: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return pose and velocity after one substep.

        The wheel speeds change at the start of the substep; the new velocity applies to all of it.

        Args:
            pose: [*B, 3] (x, y, yaw), world, m and rad; float64 for exact results.
            velocity: [*B, 2] (v, w) of the previous substep, m/s and rad/s.
            command: [*B, 2] (v, w), m/s and rad/s, clipped to the limits here.
            duration: Duration of the substep, s.
            parameters: Ignored; the base is the same in all episodes.

        Returns:
            Pose [*B, 3] and velocity [*B, 2] after the substep.
        """
        target = self.clip(command.to(pose.dtype))
        if self.model == "wheeled":
            wheels, wanted = self.wheel_speeds(velocity), self.wheel_speeds(target)
            limit = self.wheel_acceleration * duration
            target = self.velocity(wheels + (wanted - wheels).clamp(-limit, limit))
        return advance_poses(pose, target, duration), target

    def advance_one(
        self,
        pose: Sequence[float],
        velocity: Sequence[float],
        command: Sequence[float],
        duration: float,
        parameters: Tensor | None = None,
    ) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Return pose and velocity without tensors, in a few microseconds; see :meth:`advance`."""
        v = min(max(command[0], self.min_speed), self.max_speed)
        w = min(max(command[1], -self.max_turn_rate), self.max_turn_rate)
        if self.model == "wheeled":
            v, w = approach_velocity(
                velocity[0],
                velocity[1],
                v,
                w,
                self.wheel_separation,
                self.wheel_acceleration * duration,
            )
        x, y, yaw = pose
        return advance_pose(x, y, yaw, v, w, duration), (v, w)

    def travel_one(self, pose: Sequence[float], velocity: Sequence[float]) -> tuple[float, float]:
        return pose[2], velocity[0]
