"""Dynamic window approach: sample arcs, simulate them briefly, drive the best one."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.checks import check_positive
from navrl.deprecation import renamed_arguments
from navrl.ops.dynamic_window import score_commands
from navrl.ops.motion import FAR, check_descriptor_speeds, moving_points, sample_commands
from navrl.policies.classical.commands import last_command, normalized_action
from navrl.policies.controller import Controller
from navrl.sim import DifferentialDrive


class DynamicWindow(Controller):
    """Follow the path and avoid points of the scan by sampled arcs.

    Each pair of a speed and a turn rate within reach of the robot's wheels is an arc, driven for
    ``horizon_steps``. Arcs that touch a point of the pooled scan are rejected. The best of the
    others ends close to the last waypoint, with clearance, close to the path. If all are rejected,
    the arc with the latest contact is chosen.

    With ``predict_motion`` the points of a moving group are predicted: a TAGD has the group's
    previous and current position, and so its velocity. The controller is not privileged.

    Args:
        robot: Limits, hull and wheel acceleration.
        predict_motion: Whether moving descriptors are predicted at constant velocity.
        time_step_s: Time between two positions on an arc, and between two scans, s.
        horizon_steps: Number of positions on an arc.
        num_speeds: Number of sampled speeds.
        num_turn_rates: Number of sampled turn rates; odd, so that straight is one of them.
        margin: Minimum distance of the hull to points, m.
        clearance: Clearance above which more is not rewarded, m.
        clearance_weight: Weight of clearance relative to distance to the waypoint.
        path_weight: Weight of distance to the path relative to distance to the waypoint.
        min_descriptor_speed: Slower descriptors are treated as static, m/s; their motion is noise.
        max_descriptor_speed: Faster descriptors are treated as mismatches, m/s.
        group_radius: Distance to a moving centroid within which points move with it, m.

    Raises:
        ValueError: If a value is out of range.

    Reference:
        Fox, Burgard and Thrun, "The dynamic window approach to collision avoidance", 1997. Ours:
        waypoints in place of the goal's bearing, points in place of distances along the arc, and
        the motion of descriptors.
    """

    @renamed_arguments(least_speed="min_descriptor_speed", most_speed="max_descriptor_speed")
    def __init__(
        self,
        robot: DifferentialDrive,
        predict_motion: bool = False,
        time_step_s: float = 0.2,
        horizon_steps: int = 7,
        num_speeds: int = 6,
        num_turn_rates: int = 25,
        margin: float = 0.05,
        clearance: float = 0.3,
        clearance_weight: float = 1.0,
        path_weight: float = 0.3,
        min_descriptor_speed: float = 0.3,
        max_descriptor_speed: float = 1.5,
        group_radius: float = 0.3,
    ) -> None:
        super().__init__()
        check_positive(
            time_step_s=time_step_s,
            horizon_steps=horizon_steps,
            clearance=clearance,
            group_radius=group_radius,
        )
        if not min(margin, clearance_weight, path_weight) >= 0:
            raise ValueError(
                f"margin={margin}, clearance_weight={clearance_weight}, "
                f"path_weight={path_weight}: must be >= 0"
            )
        tagd = [keys.TAGD, keys.TAGD_VALID] if predict_motion else []
        self.in_keys = [keys.POINTS, keys.RETURNS, keys.WAYPOINTS, *tagd]
        self.out_keys = [keys.ACTION]
        self.robot, self.predict_motion = robot, predict_motion
        self.time_step_s, self.horizon_steps = time_step_s, horizon_steps
        self.margin, self.clearance = margin, clearance
        self.clearance_weight, self.path_weight = clearance_weight, path_weight
        self.speed_range = check_descriptor_speeds(min_descriptor_speed, max_descriptor_speed)
        self.group_radius = group_radius
        self._samples = sample_commands(
            robot.min_speed, robot.max_speed, robot.max_turn_rate, num_speeds, num_turn_rates
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[*B, 2]``."""
        batch = tensordict.batch_size
        points, returns, waypoints, *tagd = (
            tensordict.get(key).flatten(0, len(batch) - 1) if batch else tensordict.get(key)[None]
            for key in self.in_keys
        )
        if tagd:
            points, velocity = moving_points(
                points,
                returns,
                *tagd,
                speed_range=self.speed_range,
                time_step=self.time_step_s,
                group_radius=self.group_radius,
            )
        else:
            points = torch.where(returns.unsqueeze(-1), points, FAR)
            velocity = torch.zeros_like(points)
        samples = self._window(last_command(self.robot, tensordict).reshape(-1, 1, 2))
        best = self._score(samples, points, velocity, waypoints).argmax(-1)
        command = samples[torch.arange(len(points), device=points.device), best]
        action = normalized_action(self.robot, command)
        return tensordict.set(keys.ACTION, action.reshape(*batch, 2))

    def _window(self, driven: Tensor) -> Tensor:
        """Return ``[N, S, 2]`` commands that the wheels reach in a step from ``[N, 1, 2]``."""
        samples = self._samples.to(driven.device).expand(len(driven), -1, -1)
        change = self.robot.acceleration_limit * self.time_step_s
        if change == float("inf"):
            return samples
        reach = driven.new_tensor([change, 2 * change / self.robot.wheel_separation])
        return torch.minimum(torch.maximum(samples, driven - reach), driven + reach)

    def _score(
        self, samples: Tensor, points: Tensor, velocity: Tensor, waypoints: Tensor
    ) -> Tensor:
        """Return the score of each command ``[N, S]``; larger is better."""
        return score_commands(
            samples,
            points,
            velocity,
            waypoints,
            radius=self.robot.radius,
            time_step=self.time_step_s,
            horizon_steps=self.horizon_steps,
            margin=self.margin,
            clearance=self.clearance,
            clearance_weight=self.clearance_weight,
            path_weight=self.path_weight,
        )
