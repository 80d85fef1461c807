"""Goal position in the robot frame."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor
from torchrl.data import TensorSpec

from navrl import keys
from navrl.ops import se2
from navrl.transforms.observation_map import Keys, ObservationMap, real_spec, world_values


class GoalPosition(ObservationMap):
    """Transform the end of the global path to the robot frame.

    Args:
        in_keys: Pose ``[*B, 3]`` and path ``[*B, P, 2]`` in the same world frame; float64 for
            coordinates far from the origin, which is preserved until they are subtracted.
        out_keys: Goal ``[*B, 2]`` m in the robot frame.

    Raises:
        ValueError: If the number of keys is wrong, or later if the environment lacks a key.

    Example:
        >>> import torch
        >>> path = torch.tensor([[[0.0, 0.0], [4.0, 0.0]]])
        >>> GoalPosition()(pose=torch.tensor([[1.0, 0.0, 0.0]]), path=path)
        tensor([[3., 0.]])

    Reference:
        Paper Sec. V-C: task input of the baselines, in addition to or instead of waypoints.
    """

    INPUTS = ("pose", "path")
    OUTPUTS = ("goal position",)

    def __init__(
        self, in_keys: Keys = (keys.POSE, keys.PATH), out_keys: Keys = (keys.GOAL,)
    ) -> None:
        super().__init__(in_keys, out_keys)

    def map_values(self, pose: Tensor, path: Tensor) -> Sequence[Tensor]:
        """Transform the last point of the path to the robot frame."""
        pose, path = world_values(pose, path)
        goal = se2.transform_points(se2.inverse(pose), path[..., -1:, :])
        return (goal.squeeze(-2).float(),)

    def map_specs(self, pose: TensorSpec, path: TensorSpec) -> Sequence[TensorSpec]:
        """Return the spec of the goal."""
        return (real_spec(pose, *pose.shape[:-1], 2),)
