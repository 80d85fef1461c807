"""Differential drive: a kinematic base, or one with limited acceleration of its wheels."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from navrl.checks import check_positive
from navrl.ops.unicycle import advance_pose, advance_poses, approach_velocity
from navrl.sim.robot import RobotModel

MODELS = ("kinematic", "wheeled")


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

    def reachable(self, velocity: Tensor, command: Tensor, duration: float) -> Tensor:
        """Return the velocity nearest to a command; see :meth:`RobotModel.reachable`."""
        target = self.clip(command)
        if self.model != "wheeled":
            return target
        wheels, limit = self.wheel_speeds(velocity), self.wheel_acceleration * duration
        return self.velocity(wheels + (self.wheel_speeds(target) - wheels).clamp(-limit, limit))

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
        target = self.reachable(velocity, command.to(pose.dtype), duration)
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
