"""Dynamic window approach: sample arcs, simulate them briefly, drive the best one."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.checks import check_positive
from navrl.deprecation import renamed_arguments
from navrl.ops.motion import FAR, point_motion, room_along, sample_commands
from navrl.ops.unicycle import advance_poses
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
        if not 0 < min_descriptor_speed < max_descriptor_speed:
            raise ValueError(
                f"min_descriptor_speed={min_descriptor_speed}, "
                f"max_descriptor_speed={max_descriptor_speed}: "
                "must be 0 < min_descriptor_speed < max_descriptor_speed"
            )
        tagd = [keys.TAGD, keys.TAGD_VALID] if predict_motion else []
        self.in_keys = [keys.POINTS, keys.RETURNS, keys.WAYPOINTS, *tagd]
        self.out_keys = [keys.ACTION]
        self.robot, self.predict_motion = robot, predict_motion
        self.time_step_s, self.horizon_steps = time_step_s, horizon_steps
        self.margin, self.clearance = margin, clearance
        self.clearance_weight, self.path_weight = clearance_weight, path_weight
        self.speed_range = (min_descriptor_speed, max_descriptor_speed)
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
        points = torch.where(returns.unsqueeze(-1), points, FAR)
        velocity = self._point_velocity(points, *tagd) if tagd else torch.zeros_like(points)
        samples = self._window(last_command(self.robot, tensordict).reshape(-1, 1, 2))
        arcs = self._arcs(samples)
        room = self._room(arcs, points, velocity)
        best = self._score(arcs, room, waypoints).argmax(-1)
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

    def _arcs(self, samples: Tensor) -> Tensor:
        """Return ``[N, S, T, 2]`` m, positions in the robot frame after each step."""
        time_s = torch.arange(1, self.horizon_steps + 1, device=samples.device) * self.time_step_s
        driven = samples.unsqueeze(-2) * time_s.unsqueeze(-1)  # m and rad from now
        return advance_poses(torch.zeros(3, device=samples.device), driven, 1.0)[..., :2]

    def _point_velocity(self, points: Tensor, tagd: Tensor, valid: Tensor) -> Tensor:
        """Return the velocity of points, ``[N, P, 2]`` m per step; zero for static ones."""
        smallest, largest = (speed * self.time_step_s for speed in self.speed_range)
        return point_motion(
            points,
            tagd,
            valid,
            min_displacement=smallest,
            max_displacement=largest,
            group_radius=self.group_radius,
        )

    def _room(self, arcs: Tensor, points: Tensor, velocity: Tensor) -> Tensor:
        """Return ``[N, S, T]`` m from the hull to the nearest point at each step."""
        steps = range(1, self.horizon_steps + 1)
        return room_along(arcs, points, velocity, steps) - self.robot.radius

    def _score(self, arcs: Tensor, room: Tensor, waypoints: Tensor) -> Tensor:
        """Return the score of each arc ``[N, S]``; larger is better."""
        clear = (room > self.margin).cumprod(-1)  # until the first touch
        to_goal = (arcs - waypoints[:, None, -1:]).norm(dim=-1).amin(-1)
        off_path = torch.cdist(arcs[:, :, -1], waypoints).amin(-1)
        score = (
            self.clearance_weight * room.amin(-1).clamp_max(self.clearance)
            - to_goal
            - self.path_weight * off_path
        )
        # Arcs with a contact rank behind all others, ordered by the time of contact.
        return torch.where(clear[..., -1] > 0, score, clear.sum(-1) - 1e3 + room[..., 0])
