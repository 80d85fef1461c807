"""Controller with a waypoint as subgoal, the pure pursuit of subgoal actions."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase

from navrl import keys
from navrl.policies.controller import Controller


class WaypointSubgoal(Controller):
    """Follow the path with a waypoint as subgoal, without own obstacle avoidance.

    Args:
        max_distance: Maximum distance of a subgoal, m, as in
            :class:`navrl.transforms.SubgoalAction`.
        max_bearing: Maximum bearing to either side, rad, as there.
        waypoint: Index of the target waypoint.
        waypoints_key: TensorDict key of the waypoints ``[*B, N_f, 2]`` m, robot frame.

    Raises:
        ValueError: If a bound is not positive or ``waypoint`` is negative.
    """

    def __init__(
        self,
        max_distance: float = 1.0,
        max_bearing: float = 0.5 * math.pi,
        waypoint: int = 2,
        waypoints_key: str = keys.WAYPOINTS,
    ) -> None:
        super().__init__()
        if not min(max_distance, max_bearing) > 0.0 or waypoint < 0:
            raise ValueError(
                f"max_distance={max_distance}, max_bearing={max_bearing}: must be > 0; "
                f"waypoint={waypoint}: must be >= 0"
            )
        self.max_distance, self.max_bearing, self.waypoint = max_distance, max_bearing, waypoint
        self.in_keys, self.out_keys = [waypoints_key], [keys.ACTION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized subgoal ``[*B, 2]``."""
        points = tensordict.get(self.in_keys[0])
        if self.waypoint >= points.shape[-2]:
            raise ValueError(
                f"waypoint={self.waypoint}: must be < {points.shape[-2]}, the waypoints"
            )
        x, y = points[..., self.waypoint, :].unbind(-1)
        distance = 2.0 * torch.hypot(x, y) / self.max_distance - 1.0
        bearing = torch.atan2(y, x) / self.max_bearing
        action = torch.stack([distance, bearing], dim=-1)
        return tensordict.set(keys.ACTION, action.clamp(-1.0, 1.0))
