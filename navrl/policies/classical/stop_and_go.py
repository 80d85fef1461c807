"""Stop and go: pure pursuit that waits while its path is blocked."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.policies.classical.commands import normalized_action
from navrl.policies.classical.pure_pursuit import PurePursuit
from navrl.policies.controller import Controller
from navrl.sim import DifferentialDrive


class StopAndGo(Controller):
    """Drive the arc of pure pursuit; stop while a point of the scan lies on it.

    While stopped it turns to the waypoint. A stationary pedestrian on the path blocks it
    permanently, and it does not evade approaching pedestrians.

    The defaults avoid stops for walls: an arc longer than ``stop_distance`` leaves the path in
    bends and hits walls that the robot would not touch, and a pooled range, the minimum of several
    noisy ones, is biased towards the robot, which a negative ``margin`` compensates.

    Args:
        robot: Hull and limits.
        waypoint: Index of the pursued waypoint.
        stop_distance: Length of arc that must be free, m.
        margin: Added to the hull's radius, m; negative for ranges that are biased short.

    Raises:
        ValueError: If a value is out of range.
    """

    def __init__(
        self,
        robot: DifferentialDrive,
        waypoint: int = 1,
        stop_distance: float = 0.4,
        margin: float = -0.05,
    ) -> None:
        super().__init__()
        if not stop_distance > 0 or not margin > -robot.radius:
            raise ValueError(
                f"stop_distance={stop_distance}: must be > 0; "
                f"margin={margin}: must be > -{robot.radius}, the robot's radius"
            )
        if not robot.min_speed <= 0:
            raise ValueError(f"robot.min_speed={robot.min_speed}: must be <= 0, to stand still")
        self.robot, self.margin = robot, margin
        self.stop_distance = stop_distance
        self.in_keys = [keys.WAYPOINTS, keys.POINTS, keys.RETURNS]
        self.out_keys = [keys.ACTION]
        self._pursuit = PurePursuit(robot, waypoint)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[*B, 2]``."""
        waypoints, points, returns = (tensordict.get(key) for key in self.in_keys)
        command = self._pursuit.command(waypoints)
        blocked = self._is_blocked(command, points, returns)
        x, y = waypoints[..., self._pursuit.waypoint, :].unbind(-1)
        wait = torch.stack([torch.zeros_like(x), torch.atan2(y, x)], dim=-1)
        command = torch.where(blocked.unsqueeze(-1), wait, command)
        return tensordict.set(keys.ACTION, normalized_action(self.robot, command))

    def _is_blocked(self, command: Tensor, points: Tensor, returns: Tensor) -> Tensor:
        """Return ``[*B]`` whether a return lies in the area swept by the hull along the arc."""
        v, w = command.unbind(-1)
        curvature = w / v.clamp_min(1e-6)
        # At most a quarter of a circle: the rest of a tight arc is not driven.
        length = (0.5 * math.pi / curvature.abs().clamp_min(1e-6)).clamp_max(self.stop_distance)
        along = torch.linspace(0.0, 1.0, 13, device=v.device) * length.unsqueeze(-1)
        half = 0.5 * curvature.unsqueeze(-1) * along
        chord = along * torch.sinc(half / math.pi)
        arc = torch.stack([chord * half.cos(), chord * half.sin()], dim=-1)
        touches = torch.cdist(arc, points) <= self.robot.radius + self.margin
        ahead = points[..., 0] > 0.0
        blocked = (touches.any(-2) & returns & ahead).any(-1)
        return blocked & (v > 0)
