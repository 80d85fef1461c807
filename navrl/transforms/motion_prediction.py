"""Prediction of the robot's frame when its next command takes effect."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor
from torchrl.data import TensorSpec

from navrl import keys
from navrl.ops import se2
from navrl.transforms.observation_map import Keys, ObservationMap, real_spec


class MotionPrediction(ObservationMap):
    """Express pose and scan in the robot's frame at the time its next command takes effect.

    A command that is late takes effect at another place than that of the decision. If the delay is
    known, the commands under way determine this place, so a policy that decides as if it were there
    has no delay of its own motion: waypoints read the predicted pose,
    :class:`navrl.transforms.MotionCompensation` the predicted motion since the scan. Pedestrians
    are not predicted.

    Args:
        in_keys: Pose of the robot at the time when a command given now takes effect ``[*B, 3]``
            (m, m, rad), in the robot frame of the present; pose in the world ``[*B, 3]``; motion
            since the scan ``[*B, 2, 3]``.
        out_keys: Pose and motion since the scan at that time, of the same shapes.

    Example:
        >>> import torch
        >>> ahead, pose = torch.tensor([[0.1, 0.0, 0.0]]), torch.tensor([[2.0, 1.0, 0.0]])
        >>> predicted, scan = MotionPrediction()(
        ...     motion_ahead=ahead, pose=pose, scan_motion=torch.zeros(1, 2, 3)
        ... )
        >>> predicted, scan[0, 0]
        (tensor([[2.1000, 1.0000, 0.0000]]), tensor([-0.1000,  0.0000,  0.0000]))

    Reference:
        Not in the paper, whose commands take effect at once. Nav2's model predictive controller
        replays the commands under way for the same purpose.
    """

    INPUTS = ("motion ahead", "pose", "motion since the scan")
    OUTPUTS = ("pose", "motion since the scan")

    def __init__(
        self,
        in_keys: Keys = (keys.MOTION_AHEAD, keys.POSE, keys.SCAN_MOTION),
        out_keys: Keys = (keys.POSE_AHEAD, keys.SCAN_MOTION_AHEAD),
    ) -> None:
        """Set the keys."""
        super().__init__(in_keys, out_keys)

    def map_values(self, ahead: Tensor, pose: Tensor, scan: Tensor) -> Sequence[Tensor]:
        """Return the pose and the motion since the scan at the predicted time."""
        frames = se2.relative(ahead.to(scan).unsqueeze(-2).expand_as(scan), scan)
        return se2.compose(pose, ahead.to(pose)), frames

    def map_specs(self, ahead: TensorSpec, pose: TensorSpec, scan: TensorSpec) -> list[TensorSpec]:
        """Return the specs of pose and motion."""
        return [pose.clone(), real_spec(scan, *scan.shape)]
