"""Subgoals as actions."""

from __future__ import annotations

import math

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite

from navrl import keys
from navrl.ops.subgoal import free_distance, steer_to
from navrl.transforms.action_map import ActionMap, check_positive
from navrl.transforms.observation_map import Keys


class SubgoalAction(ActionMap):
    """Take an action as a point to go to, not as a velocity.

    The policy names a distance and a bearing from the robot. The point is drawn back on its ray
    until the robot, pushed straight to it, would touch nothing that the scan sees, and a
    closed-form controller drives the arc towards it for one step.

    Towards the policy the action becomes (distance, bearing) in ``[0, max_distance]`` m and
    ``[-max_bearing, max_bearing]`` rad, which TorchRL's ``ActionScaling`` behind it scales to
    [-1, 1]; the environment before it gets (v, w).

    Args:
        max_distance: Farthest subgoal, m.
        max_bearing: Largest bearing to either side, rad; at most pi.
        horizon: Time in which the controller would reach the subgoal, s. With a horizon of
            ``max_distance / max_speed`` the farthest subgoal ahead is driven to at full speed.
        radius: Of the robot, m: kept between the subgoal and any return.
        max_speed: Of the robot, m/s.
        max_turn_rate: Of the robot, rad/s.
        scan_keys: Points ``[*B, N, 2]`` m in the robot frame and returns ``[*B, N]`` bool, at the
            time of the action.
        action_key: The action, for both sides.

    Raises:
        ValueError: If a value is not positive or too large, or later if a key is missing.

    Reference:
        de Heuvel et al., "Subgoal-Driven Navigation in Dynamic Environments Using Attention-Based
        Deep Reinforcement Learning", 2023; paper Sec. V-C3. There a second network is trained to
        drive to the subgoals. Here it is an arc in closed form: the comparison is about what an
        action means, and one network is trained as for all others.
    """

    def __init__(
        self,
        max_distance: float = 1.0,
        max_bearing: float = 0.5 * math.pi,
        horizon: float = 1.0,
        radius: float = 0.178,
        max_speed: float = 1.0,
        max_turn_rate: float = math.pi,
        scan_keys: Keys = (keys.POINTS, keys.RETURNS),
        action_key: NestedKey | list[str] = keys.ACTION,
    ) -> None:
        super().__init__(("points", "returns"), scan_keys, action_key)
        check_positive(
            max_distance=max_distance,
            max_bearing=max_bearing,
            horizon=horizon,
            radius=radius,
            max_speed=max_speed,
            max_turn_rate=max_turn_rate,
        )
        if max_bearing > math.pi:
            raise ValueError(f"max_bearing must be at most pi (rad), got {max_bearing}")
        self.max_distance, self.max_bearing = max_distance, max_bearing
        self.horizon, self.radius = horizon, radius
        self.max_speed, self.max_turn_rate = max_speed, max_turn_rate

    def subgoal(self, action: Tensor, points: Tensor, returns: Tensor) -> Tensor:
        """Return the collision-free subgoal ``[*B, 2]`` (distance m, bearing rad).

        Args:
            action: ``[*B, 2]`` the subgoal that was asked for; limited to its bounds here.
            points: ``[*B, N, 2]`` m, robot frame.
            returns: ``[*B, N]`` bool.
        """
        distance, bearing = action.unbind(-1)
        bearing = bearing.clamp(-self.max_bearing, self.max_bearing)
        free = free_distance(points.float(), returns, bearing, self.radius)
        distance = torch.minimum(distance.clamp(0.0, self.max_distance), free)
        return torch.stack([distance, bearing], dim=-1)

    def command(self, action: Tensor, *seen: Tensor) -> Tensor:
        """Return the command ``[*B, 2]`` that leads to a subgoal; as :meth:`subgoal` otherwise."""
        distance, bearing = self.subgoal(action, *seen).unbind(-1)
        return steer_to(distance, bearing, self.horizon, self.max_speed, self.max_turn_rate)

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Bound the action as a subgoal, and declare that a step reads the scan."""
        input_spec = super().transform_input_spec(input_spec)
        command = input_spec["full_action_spec"][self.in_keys_inv[0]]
        high = torch.tensor([self.max_distance, self.max_bearing], device=command.device)
        low = torch.tensor([0.0, -self.max_bearing], device=command.device)
        bounds = (bound.expand(command.shape).contiguous() for bound in (low, high))
        input_spec["full_action_spec"][self.out_keys_inv[0]] = Bounded(
            *bounds, command.shape, dtype=torch.float32, device=command.device
        )
        return input_spec
