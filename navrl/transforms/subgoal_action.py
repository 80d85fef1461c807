"""Action transform from subgoals to velocity commands."""

from __future__ import annotations

import math

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec

from navrl import keys
from navrl.checks import check_positive
from navrl.ops.subgoal import free_distance, steer_to
from navrl.transforms.action_map import ActionMap
from navrl.transforms.observation_map import Keys


class SubgoalAction(ActionMap):
    """Interpret an action as a subgoal and convert it to a velocity command.

    The policy selects a distance and a bearing from the robot. The distance is reduced along the
    ray until a straight translation of the robot to the subgoal is free of contact with the scan,
    and a closed-form controller follows the arc towards it for one step.

    The action of the policy is (distance, bearing) in ``[0, max_distance]`` m and
    ``[-max_bearing, max_bearing]`` rad, which a following ``ActionScaling`` of TorchRL scales to
    [-1, 1]; the environment receives (v, w).

    Args:
        max_distance: Largest distance of a subgoal, m.
        max_bearing: Largest bearing to either side, rad; at most pi.
        horizon: Time in which the controller would reach the subgoal, s. With a horizon of
            ``max_distance / max_speed`` the robot approaches the farthest subgoal at full speed.
        radius: Radius of the robot, m; smallest distance between a subgoal and a return.
        max_speed: Largest forward speed of the robot, m/s.
        max_turn_rate: Largest turn rate of the robot, rad/s.
        scan_keys: Points ``[*B, N, 2]`` m in the robot frame and returns ``[*B, N]`` bool, at the
            time of the action.
        action_key: Key of the action, on both sides.

    Raises:
        ValueError: If a value is not positive or too large, or later if a key is missing.

    Example:
        >>> action = SubgoalAction(max_distance=1.0, horizon=2.0, radius=0.178)
        >>> free = torch.tensor([[[0.0, 3.5]]]), torch.tensor([[False]])
        >>> action.command(torch.tensor([[1.0, 0.0]]), *free)  # 1 m ahead in 2 s
        tensor([[0.5000, 0.0000]])

    Reference:
        de Heuvel et al., "Subgoal-Driven Navigation in Dynamic Environments Using Attention-Based
        Deep Reinforcement Learning", 2023; paper Sec. V-C3. That work trains a second network that
        drives to the subgoals. This transform uses a closed-form arc, so that the comparison is
        about the action space and only one network is trained, as for all other policies.
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
            raise ValueError(f"max_bearing={max_bearing}: must be at most pi (rad)")
        self.max_distance, self.max_bearing = max_distance, max_bearing
        self.horizon, self.radius = horizon, radius
        self.max_speed, self.max_turn_rate = max_speed, max_turn_rate

    def subgoal(self, action: Tensor, points: Tensor, returns: Tensor) -> Tensor:
        """Return the collision-free subgoal ``[*B, 2]`` (distance m, bearing rad).

        Args:
            action: ``[*B, 2]``, requested subgoal; clamped to its bounds here.
            points: ``[*B, N, 2]`` m, robot frame.
            returns: ``[*B, N]`` bool.
        """
        distance, bearing = action.unbind(-1)
        bearing = bearing.clamp(-self.max_bearing, self.max_bearing)
        free = free_distance(points.float(), returns, bearing, self.radius)
        distance = torch.minimum(distance.clamp(0.0, self.max_distance), free)
        return torch.stack([distance, bearing], dim=-1)

    def command(self, action: Tensor, *seen: Tensor) -> Tensor:
        """Return the command ``[*B, 2]`` (v, w) towards the subgoal; see :meth:`subgoal`."""
        distance, bearing = self.subgoal(action, *seen).unbind(-1)
        return steer_to(distance, bearing, self.horizon, self.max_speed, self.max_turn_rate)

    def transform_input_spec(self, input_spec: TensorSpec) -> Composite:
        """Set the bounds of the subgoal as action spec and add the scan keys to the state spec."""
        input_spec = super().transform_input_spec(input_spec)
        command = input_spec["full_action_spec"][self.in_keys_inv[0]]
        high = torch.tensor([self.max_distance, self.max_bearing], device=command.device)
        low = torch.tensor([0.0, -self.max_bearing], device=command.device)
        low, high = (bound.expand(command.shape).contiguous() for bound in (low, high))
        input_spec["full_action_spec"][self.out_keys_inv[0]] = Bounded(
            low, high, command.shape, dtype=torch.float32, device=command.device
        )
        return input_spec
