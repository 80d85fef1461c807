"""Limits that the deployer of a robot sets, beside those of its policy."""

from __future__ import annotations

import math
from dataclasses import dataclass

from navrl.checks import check_positive, is_real


@dataclass(frozen=True)
class ControlLimits:
    """Timeouts, and limits of speed and acceleration.

    A command above a limit of speed is scaled as a whole, so that the arc is that of the policy.
    The limits of acceleration apply while driving; a stop is commanded at once.

    Args:
        scan_timeout_s: Age of a scan's last beam above which the robot stops, s.
        pose_timeout_s: Age of the pose above which the robot stops, s: that of the latest odometry,
            or of the latest pose without odometry.
        localization_timeout_s: Age of the latest pose in the path's frame above which the robot
            stops although it has odometry, s. Localization by AMCL reports only while moving.
        max_clock_skew_s: Time by which a stamp may be in the future, s.
        max_step_s: Time between two scans above which the scan history restarts, s; None for twice
            the policy's time step.
        speed_scale: Factor of all commands, in (0, 1].
        max_speed: Largest forward speed, m/s.
        max_reverse_speed: Largest reverse speed, m/s.
        max_turn_rate: Largest turn rate, rad/s.
        linear_acceleration: Largest increase of the speed, m/s^2.
        linear_deceleration: Largest decrease of the speed, m/s^2.
        angular_acceleration: Largest change of the turn rate, rad/s^2.
        frozen_motion: Distance, m, or turn, rad, over which identical scans mean that the lidar's
            driver repeats an old one.

    Raises:
        ValueError: If a value is not positive; the message names it.
    """

    scan_timeout_s: float = 0.5
    pose_timeout_s: float = 0.5
    localization_timeout_s: float = math.inf
    max_clock_skew_s: float = 0.1
    max_step_s: float | None = None
    speed_scale: float = 1.0
    max_speed: float = math.inf
    max_reverse_speed: float = math.inf
    max_turn_rate: float = math.inf
    linear_acceleration: float = math.inf
    linear_deceleration: float = math.inf
    angular_acceleration: float = math.inf
    frozen_motion: float = 0.1

    def __post_init__(self) -> None:
        """Check the values."""
        finite = {"scan_timeout_s", "pose_timeout_s", "max_clock_skew_s", "frozen_motion"}
        for name, value in vars(self).items():
            if name in finite:
                check_positive(**{name: value})
            elif name == "max_step_s" and value is None:
                continue
            elif not (is_real(value) and value > 0.0):
                raise ValueError(f"{name}={value!r}: must be positive")
        if self.speed_scale > 1.0:
            raise ValueError(f"speed_scale={self.speed_scale}: must be in (0, 1]")

    def limited(
        self, command: tuple[float, float], last: tuple[float, float], duration: float
    ) -> tuple[float, float]:
        """Return a command within the limits.

        Args:
            command: (v, w) of the policy, m/s and rad/s.
            last: (v, w) commanded before.
            duration: Time since then, s.

        Example:
            >>> ControlLimits(max_speed=0.5).limited((1.0, 0.4), (0.5, 0.2), 0.2)
            (0.5, 0.2)
        """
        v, w = (self.speed_scale * value for value in command)
        top = self.max_speed if v > 0.0 else self.max_reverse_speed
        factor = min(1.0, top / max(abs(v), 1e-12), self.max_turn_rate / max(abs(w), 1e-12))
        v, w = factor * v, factor * w
        rise, fall = self.linear_acceleration * duration, self.linear_deceleration * duration
        below, above = (fall, rise) if last[0] >= 0.0 else (rise, fall)
        turn = self.angular_acceleration * duration
        return (
            min(max(v, last[0] - below), last[0] + above),
            min(max(w, last[1] - turn), last[1] + turn),
        )
