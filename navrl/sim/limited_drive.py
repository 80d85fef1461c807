"""Differential drive with the limits and errors of a real base, fixed or drawn per episode."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from navrl.ops.unicycle import advance_poses
from navrl.sim.differential_drive import DifferentialDrive
from navrl.sim.draws import Uniform, Value, draw_row, limits, nominal
from navrl.sim.robot import RobotModel

# Pairs (v, w) of columns of the parameters; each pair is one stage.
# The last pair is (rim acceleration, unused).
SCALE, BIAS, CAP, LAG, ACCELERATION, DECELERATION, WHEELS = range(7)

_SUBSTEP_S = 0.02  # of the simulators


class LimitedDrive(DifferentialDrive):
    """Differential drive with limited accelerations, lag, and errors of scale and bias.

    At the start of each substep the velocity changes as follows; then it applies to all of it, on
    an exact circular arc:

    1. The command is clipped to the command limits.
    2. It is multiplied by the scale and the bias is added. A command of exactly (0, 0) remains
       zero: a motor driver holds a stopped robot still, so a bias never makes it creep.
    3. Magnitudes are limited to the caps, which are unknown to the policy.
    4. The velocity approaches the result with a first-order lag.
    5. The changes of v and of w are limited. The limit of deceleration applies while the magnitude
       falls, and to a substep in which the sign changes.
    6. The changes of the rim speeds of the wheels are limited. This does not increase the changes
       of v and of w.

    Each ``Value`` is a number, or a distribution from which each episode draws one. The defaults
    have no effect: the model is then the kinematic :class:`DifferentialDrive`.

    Args:
        radius: Radius of the hull, m.
        wheel_separation: Distance between the contact points of the wheels, m.
        max_speed: Largest forward speed of commands, m/s.
        max_turn_rate: Largest turn rate of commands to either side, rad/s.
        min_speed: Smallest forward speed of commands, m/s; negative values allow reverse motion.
        linear_acceleration: Largest increase of |v|, m/s^2.
        linear_deceleration: Largest decrease of |v|, m/s^2; None for the same as the acceleration.
        angular_acceleration: Largest increase of |w|, rad/s^2.
        angular_deceleration: Largest decrease of |w|, rad/s^2; None for the same as the
            acceleration.
        wheel_acceleration: Largest acceleration of each wheel's rim, m/s^2.
        linear_lag_s: Time constant of v, s; after it 63 % of a step are reached.
        angular_lag_s: Time constant of w, s.
        linear_scale: Factor of v.
        angular_scale: Factor of w.
        linear_bias: Bias of v, m/s.
        angular_bias: Bias of w, rad/s.
        speed_cap: Largest |v| of the base, m/s.
        turn_rate_cap: Largest |w| of the base, rad/s.

    Raises:
        ValueError: If a value is out of range.

    Example:
        >>> base = LimitedDrive(linear_acceleration=0.5, linear_deceleration=0.6)
        >>> _, velocity = base.advance_one((0.0, 0.0, 0.0), (0.0, 0.0), (1.0, 0.0), 0.2)
        >>> velocity
        (0.1, 0.0)
    """

    def __init__(
        self,
        radius: float = 0.178,
        wheel_separation: float = 0.23,
        max_speed: float = 1.0,
        max_turn_rate: float = math.pi,
        min_speed: float = 0.0,
        linear_acceleration: Value = math.inf,
        linear_deceleration: Value | None = None,
        angular_acceleration: Value = math.inf,
        angular_deceleration: Value | None = None,
        wheel_acceleration: Value = math.inf,
        linear_lag_s: Value = 0.0,
        angular_lag_s: Value = 0.0,
        linear_scale: Value = 1.0,
        angular_scale: Value = 1.0,
        linear_bias: Value = 0.0,
        angular_bias: Value = 0.0,
        speed_cap: Value = math.inf,
        turn_rate_cap: Value = math.inf,
    ) -> None:
        """Check and store the arguments."""
        super().__init__(radius, wheel_separation, max_speed, max_turn_rate, min_speed)
        speeding = (
            ("linear_acceleration", linear_acceleration),
            ("angular_acceleration", angular_acceleration),
        )
        braking = (
            ("linear_deceleration", linear_deceleration),
            ("angular_deceleration", angular_deceleration),
        )
        pairs = (
            (("linear_scale", linear_scale), ("angular_scale", angular_scale)),
            (("linear_bias", linear_bias), ("angular_bias", angular_bias)),
            (("speed_cap", speed_cap), ("turn_rate_cap", turn_rate_cap)),
            (("linear_lag_s", linear_lag_s), ("angular_lag_s", angular_lag_s)),
            speeding,
            # the name determines the draw, so an omitted deceleration equals the acceleration
            [
                (own[0], own[1]) if own[1] is not None else other
                for own, other in zip(braking, speeding, strict=True)
            ],
            (("wheel_acceleration", wheel_acceleration), ("", math.inf)),
        )
        self._values: list[tuple[str, Value]] = [named for pair in pairs for named in pair]
        for name, value in self._values:
            _check(name, value)
        self._is_varied = any(isinstance(value, Uniform) for _, value in self._values)
        self._stages = _stages_in_use(self._values)
        if self._stages:
            self.model = "limited"
        self._nominal = [nominal(value) for _, value in self._values]
        self.wheel_acceleration = self._nominal[2 * WHEELS]
        self._constants: dict[tuple[torch.device, torch.dtype], tuple[Tensor, Tensor, Tensor]] = {}

    @property
    def is_compiled(self) -> bool:
        """Return whether no limit or error has an effect: the kinematic model applies."""
        return not self._stages and type(self).advance is LimitedDrive.advance

    @property
    def acceleration_limit(self) -> float:
        """Acceleration of the rims that the nominal limits always allow, m/s^2."""
        linear, angular = self._nominal[2 * ACCELERATION : 2 * ACCELERATION + 2]
        return min(linear, 0.5 * self.wheel_separation * angular, self.wheel_acceleration)

    def draw(self, seed: Tensor) -> Tensor:
        """Draw the parameters of episodes; P = 0 if all values are fixed.

        Args:
            seed: [M] int64, ``noise_seed`` of the scenarios.

        Returns:
            [M, P] float64; a value has the same draw in any batch and on any device.
        """
        if not self._is_varied:
            return super().draw(seed)
        return draw_row([(f"robot.{name}", value) for name, value in self._values], seed)

    def advance(
        self,
        pose: Tensor,
        velocity: Tensor,
        command: Tensor,
        duration: float,
        parameters: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return pose and velocity after one substep.

        Args:
            pose: [*B, 3] (x, y, yaw), world, m and rad; float64 for exact results.
            velocity: [*B, 2] (v, w) of the previous substep, m/s and rad/s.
            command: [*B, 2] (v, w), m/s and rad/s, clipped to the limits here.
            duration: Duration of the substep, s.
            parameters: [*B, P] of :meth:`draw`; None for the nominal base, which has the median of
                each distribution.

        Returns:
            Pose [*B, 3] and velocity [*B, 2] after the substep.
        """
        if not self._stages:
            return super().advance(pose, velocity, command, duration)
        poses, velocities = self.rollout(pose, velocity, command[None], duration, parameters)
        return poses[0], velocities[0]

    def rollout(
        self,
        pose: Tensor,
        velocity: Tensor,
        commands: Tensor,
        duration: float,
        parameters: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Return poses and velocities after each of S substeps; see :meth:`RobotModel.rollout`."""
        if not self._stages:
            return super().rollout(pose, velocity, commands, duration)
        low, high, row = self._constants_like(pose)
        row = row if parameters is None else parameters.to(pose)
        pairs = row.unflatten(-1, (WHEELS + 1, 2)).unbind(-2)
        targets = self._disturbed(torch.clamp(commands.to(pose), low, high), pairs)
        velocities = self._approach(velocity, targets, duration, pairs)
        turn_rate = velocities[..., 1]
        yaw = pose[..., 2] + duration * (turn_rate.cumsum(0) - turn_rate)  # before each substep
        start = torch.stack((torch.zeros_like(yaw), torch.zeros_like(yaw), yaw), dim=-1)
        moved = advance_poses(start, velocities, duration)
        place = pose[..., :2] + moved[..., :2].cumsum(0)
        return torch.cat((place, moved[..., 2:]), dim=-1), velocities

    def advance_one(
        self,
        pose: Sequence[float],
        velocity: Sequence[float],
        command: Sequence[float],
        duration: float,
        parameters: Tensor | None = None,
    ) -> tuple[tuple[float, float, float], tuple[float, float]]:
        """Return pose and velocity of one robot as numbers; see :meth:`advance`."""
        if not self._stages:
            return super().advance_one(pose, velocity, command, duration)
        (x, y, yaw), (v, w) = RobotModel.advance_one(
            self, pose, velocity, command, duration, parameters
        )
        return (x, y, yaw), (v, w)

    def reachable(self, velocity: Tensor, command: Tensor, duration: float) -> Tensor:
        """Return the velocity nearest to a command that the nominal accelerations allow.

        Lag, errors and caps are not considered; see :meth:`RobotModel.reachable`.
        """
        low, high, row = self._constants_like(velocity)
        pairs = row.unflatten(-1, (WHEELS + 1, 2)).unbind(-2)
        target = torch.clamp(command.to(velocity), low, high)
        # In substeps, because a velocity that changes its sign decelerates before it accelerates.
        count = max(1, round(duration / _SUBSTEP_S))
        changes = _changes(duration / count, pairs)
        for _ in range(count):
            velocity = self._accelerated(velocity, target, *changes)
        return velocity

    def _constants_like(self, pose: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the command limits [2] each and the nominal parameters [14], in memory."""
        key = (pose.device, pose.dtype)
        if key not in self._constants:
            low, high, row = (pose.new_tensor(row) for row in (*self.command_limits, self._nominal))
            self._constants[key] = (low, high, row)
        return self._constants[key]

    def _disturbed(self, commands: Tensor, pairs: Sequence[Tensor]) -> Tensor:
        """Return the velocities [S, *B, 2] that the base aims at for clipped commands."""
        targets = commands
        if SCALE in self._stages:
            targets = targets * pairs[SCALE]
        if BIAS in self._stages:
            targets = targets + pairs[BIAS] * (commands != 0).any(-1, keepdim=True)
        if CAP in self._stages:
            targets = torch.clamp(targets, -pairs[CAP], pairs[CAP])
        return targets

    def _approach(
        self, velocity: Tensor, targets: Tensor, duration: float, pairs: Sequence[Tensor]
    ) -> Tensor:
        """Return the velocities [S, *B, 2] after substeps of lag and limited acceleration."""
        share = -torch.expm1(-duration / pairs[LAG])  # of the difference, in a substep
        changes = _changes(duration, pairs)
        velocities = []
        for target in targets:
            if LAG in self._stages:
                target = velocity + share * (target - velocity)
            velocity = self._accelerated(velocity, target, *changes)
            velocities.append(velocity)
        return torch.stack(velocities)

    def _accelerated(
        self, velocity: Tensor, target: Tensor, faster: Tensor, slower: Tensor, rim: Tensor
    ) -> Tensor:
        """Return the velocity [*B, 2] nearest to the target within the largest changes."""
        if ACCELERATION in self._stages:
            limit = torch.where(velocity * (target - velocity) < 0, slower, faster)
            target = torch.clamp(target, velocity - limit, velocity + limit)
        if WHEELS in self._stages:
            target = velocity + self._limited_by_wheels(target - velocity, rim)
        return target

    def _limited_by_wheels(self, change: Tensor, limit: Tensor) -> Tensor:
        """Return the change [*B, 2] of (v, w) with rim speeds that change by at most ``limit``."""
        dv, dw = change.unbind(-1)
        half = 0.5 * self.wheel_separation * dw
        left, right = torch.clamp(dv - half, -limit, limit), torch.clamp(dv + half, -limit, limit)
        return torch.stack((0.5 * (left + right), (right - left) / self.wheel_separation), dim=-1)


def _changes(duration: float, pairs: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """Return the largest increase and decrease of (v, w), [*B, 2], and change of a rim, [*B]."""
    acceleration, deceleration, wheels = pairs[ACCELERATION], pairs[DECELERATION], pairs[WHEELS]
    return duration * acceleration, duration * deceleration, duration * wheels[..., 0]


def _check(name: str, value: Value) -> None:
    """Raise a ``ValueError`` if a value or a limit of its distribution is out of range."""
    low, high = limits(value)
    if name.endswith("_bias"):
        is_valid, wanted = -math.inf < low and high < math.inf, "finite"
    elif name.endswith("_lag_s"):
        is_valid, wanted = low >= 0.0 and high < math.inf, "finite and >= 0 s"
    elif name.endswith("_scale"):
        is_valid, wanted = low > 0.0 and high < math.inf, "positive and finite"
    else:
        is_valid, wanted = low > 0.0, "positive"  # infinite for no limit
    if not is_valid:
        raise ValueError(f"{name}={value}: must be {wanted}")


def _stages_in_use(values: Sequence[tuple[str, Value]]) -> frozenset[int]:
    """Return the stages of which a value differs from the one without effect."""
    ideal = {SCALE: 1.0, BIAS: 0.0, LAG: 0.0}
    used = {
        index // 2
        for index, (_, value) in enumerate(values)
        if any(limit != ideal.get(index // 2, math.inf) for limit in limits(value))
    }
    if DECELERATION in used:
        used.add(ACCELERATION)  # both are applied in one stage
    return frozenset(used)
