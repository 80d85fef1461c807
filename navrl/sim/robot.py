"""The robot: a disc on two wheels, and what its drive can do."""

import math

import torch
from torch import Tensor

from navrl.ops.unicycle import advance_pose, advance_poses, approach_velocity

MODELS = ("kinematic", "wheeled")


class DifferentialDrive:
    """Two driven wheels under a disc-shaped hull, commanded by (v, w).

    ``kinematic`` obeys a command at once, as the paper's simulation does. In ``wheeled`` the wheel
    speeds approach those that the command asks for by at most ``wheel_acceleration`` times the
    duration, as a real base's controller makes them. Both drive exact circular arcs. The state is
    (pose, wheel speeds); the object itself holds parameters only.

    Args:
        radius: of the hull, m.
        wheel_separation: distance between the wheels' contact points, m.
        max_speed: largest forward speed, m/s.
        max_turn_rate: largest turn rate to either side, rad/s.
        min_speed: smallest forward speed, m/s; negative allows driving backwards.
        model: ``kinematic`` or ``wheeled``.
        wheel_acceleration: of each wheel's rim, m/s^2; used by ``wheeled`` alone.

    Raises:
        ValueError: a value is outside of its range.

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
        positive = {
            "radius": radius,
            "wheel_separation": wheel_separation,
            "max_speed": max_speed,
            "max_turn_rate": max_turn_rate,
            "wheel_acceleration": wheel_acceleration,
        }
        for name, value in positive.items():
            if not (value > 0.0 and math.isfinite(value)):
                raise ValueError(f"{name} must be positive and finite, got {value}")
        if not -math.inf < min_speed < max_speed:
            raise ValueError(
                f"min_speed must be finite and less than max_speed={max_speed}, got {min_speed}"
            )
        if model not in MODELS:
            raise ValueError(f"model must be one of {', '.join(MODELS)}, got {model!r}")
        self.radius = float(radius)
        self.wheel_separation = float(wheel_separation)
        self.max_speed = float(max_speed)
        self.max_turn_rate = float(max_turn_rate)
        self.min_speed = float(min_speed)
        self.model = model
        self.wheel_acceleration = float(wheel_acceleration)

    @property
    def acceleration_limit(self) -> float:
        """Largest change of a wheel's speed, m/s^2; infinite for the kinematic model."""
        return self.wheel_acceleration if self.model == "wheeled" else math.inf

    @property
    def command_limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Smallest and largest command, each (v, w) in m/s and rad/s."""
        return (self.min_speed, -self.max_turn_rate), (self.max_speed, self.max_turn_rate)

    def clip(self, command: Tensor) -> Tensor:
        """Return the command [*B, 2] (v, w) within the robot's limits."""
        v, w = command.unbind(-1)
        return torch.stack(
            (
                v.clamp(self.min_speed, self.max_speed),
                w.clamp(-self.max_turn_rate, self.max_turn_rate),
            ),
            dim=-1,
        )

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
        self, pose: Tensor, velocity: Tensor, command: Tensor, duration: float
    ) -> tuple[Tensor, Tensor]:
        """Drive for one substep.

        The new velocity holds over the whole substep: the wheels change speed at its start.

        Args:
            pose: [*B, 3] (x, y, yaw), world; float64 for exact work.
            velocity: [*B, 2] (v, w) of the substep before.
            command: [*B, 2] (v, w), clipped to the limits here.
            duration: s.

        Returns:
            Pose and velocity after the substep.
        """
        target = self.clip(command.to(pose.dtype))
        if self.model == "wheeled":
            wheels, wanted = self.wheel_speeds(velocity), self.wheel_speeds(target)
            limit = self.wheel_acceleration * duration
            target = self.velocity(wheels + (wanted - wheels).clamp(-limit, limit))
        return advance_poses(pose, target, duration), target

    def advance_one(
        self,
        pose: tuple[float, float, float],
        velocity: tuple[float, float],
        command: tuple[float, float],
        duration: float,
    ) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """:meth:`advance` for one robot in plain numbers: no tensors, a few microseconds."""
        v = min(max(command[0], self.min_speed), self.max_speed)
        w = min(max(command[1], -self.max_turn_rate), self.max_turn_rate)
        if self.model == "wheeled":
            v, w = approach_velocity(
                *velocity, v, w, self.wheel_separation, self.wheel_acceleration * duration
            )
        return advance_pose(*pose, v, w, duration), (v, w)
