"""Pure pursuit: steer to a waypoint ahead, without obstacle avoidance."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.policies.classical.commands import normalized_action
from navrl.policies.controller import Controller
from navrl.sim import DifferentialDrive


class PurePursuit(Controller):
    """Follow the path at full speed on the arc through a waypoint.

    Args:
        robot: Robot whose limits scale the action.
        waypoint: Index of the pursued waypoint.
        waypoints_key: TensorDict key of the waypoints ``[*B, N_f, 2]`` m, robot frame.

    Raises:
        ValueError: If ``waypoint`` is negative.

    Reference:
        Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU 1992. Slowing
        down so that the arc stays within the turn rate is ours.
    """

    def __init__(
        self,
        robot: DifferentialDrive,
        waypoint: int = 1,
        waypoints_key: str = keys.WAYPOINTS,
    ) -> None:
        super().__init__()
        if waypoint < 0:
            raise ValueError(f"waypoint={waypoint}: must be >= 0")
        self.robot, self.waypoint = robot, waypoint
        self.in_keys, self.out_keys = [waypoints_key], [keys.ACTION]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[*B, 2]``."""
        command = self.command(tensordict.get(self.in_keys[0]))
        return tensordict.set(keys.ACTION, normalized_action(self.robot, command))

    def command(self, waypoints: Tensor) -> Tensor:
        """Return (v, w) ``[*B, 2]``, m/s and rad/s, for waypoints ``[*B, N_f, 2]``.

        Raises:
            ValueError: If ``waypoint`` exceeds the number of waypoints.
        """
        if self.waypoint >= waypoints.shape[-2]:
            raise ValueError(
                f"waypoint={self.waypoint}: must be < {waypoints.shape[-2]}, the waypoints"
            )
        x, y = waypoints[..., self.waypoint, :].unbind(-1)
        squared = (x.square() + y.square()).clamp_min(1e-6)
        curvature = 2 * y / squared
        robot = self.robot
        speed = torch.minimum(
            torch.full_like(x, robot.max_speed),
            robot.max_turn_rate / curvature.abs().clamp_min(1e-6),
        )
        # A goal behind the robot: turn in place.
        turn_only = x < 0
        speed = torch.where(turn_only, 0.0, speed)
        side = torch.where(y < 0, -1.0, 1.0)  # never 0: turn left for a goal exactly behind
        turn = torch.where(turn_only, side * robot.max_turn_rate, speed * curvature)
        return torch.stack([speed, turn], dim=-1)
