"""Where the goal is, seen from the robot."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor
from torchrl.data import TensorSpec

from navrl import keys
from navrl.ops import se2
from navrl.transforms.observation_map import Keys, ObservationMap, real_spec, world_values


class GoalPosition(ObservationMap):
    """Give the end of the global path in the robot frame, however far away it is.

    Args:
        in_keys: Pose ``[*B, 3]`` and path ``[*B, P, 2]``, in the same world; far from its origin
            in float64, which is kept until they are subtracted.
        out_keys: Goal ``[*B, 2]`` m in the robot frame.

    Raises:
        ValueError: If the number of keys is not right, or later if the environment lacks one.

    Reference:
        Paper Sec. V-C: what the baselines see of the task beside waypoints, or instead of them.
    """

    INPUTS = ("pose", "path")
    OUTPUTS = ("goal position",)

    def __init__(
        self, in_keys: Keys = (keys.POSE, keys.PATH), out_keys: Keys = (keys.GOAL,)
    ) -> None:
        super().__init__(in_keys, out_keys)

    def map_values(self, pose: Tensor, path: Tensor) -> Sequence[Tensor]:
        """Transform the path's last point."""
        pose, path = world_values(pose, path)
        goal = se2.transform_points(se2.inverse(pose), path[..., -1:, :])
        return (goal.squeeze(-2).float(),)

    def map_specs(self, pose: TensorSpec, path: TensorSpec) -> Sequence[TensorSpec]:
        """Return the spec of the goal."""
        return (real_spec(pose, *pose.shape[:-1], 2),)
