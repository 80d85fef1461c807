"""Velocity of what moves, from moving returns that are followed through past scans."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from navrl import keys
from navrl.ops.motion import FAR
from navrl.ops.tracking import check_tracking, track_groups
from navrl.transforms.aligned_history import AlignedHistory
from navrl.transforms.observation_map import Keys, flag_spec, read, read_spec, real_spec


class TrackFlow(AlignedHistory):
    """Follow the moving returns of :class:`EstimateFlow` through past scans.

    The network of :class:`navrl.transforms.EstimateFlow` separates moving returns from static ones
    better than it estimates their velocity. This transform uses the former: a return moves if the
    two positions of its flow differ. The outputs have the form of the descriptors of
    :class:`navrl.transforms.TAGD`, so :class:`navrl.transforms.ActionShield` reads either.

    As in :class:`navrl.transforms.ScanHistory` the past is stored in the TensorDict. After a reset
    there is no past, so nothing has a valid motion in the first step.

    Args:
        num_scans: Number of past scans K.
        num_groups: Number of directions G in which what moves is searched.
        radius: Distance of the returns of a group to its position, m.
        gate: Distance up to which the nearest return continues a track without a return within
            ``radius``, m.
        max_rms: Root mean square distance of a track's positions to a line above which it has no
            valid motion, m.
        max_range: Range of the group center in a direction without a moving return, m.
        in_keys: Flow ``[*B, N, 4]`` m and its validity ``[*B, N, 2]`` bool of
            :class:`navrl.transforms.EstimateFlow`, and T_target_source ``[*B, 3]`` of frame t-1 in
            frame t.
        out_keys: Positions at t-1 and t ``[*B, G, 4]`` m in frame t, their validity ``[*B, G, 2]``
            bool, and the moving returns of past scans ``[*B, K, N, 2]`` m in frame t, scan t-1
            first, both coordinates :data:`navrl.ops.motion.FAR` for the other points.

    Raises:
        ValueError: If an argument is invalid, a number of keys is wrong, or later if the
            environment lacks a key.

    Example:
        >>> no_motion = torch.zeros(1, 3)
        >>> flow = torch.tensor([[[1.1, 0.0, 1.0, 0.0]]])
        >>> is_return = torch.ones(1, 1, 2, dtype=torch.bool)
        >>> step = TrackFlow(num_groups=4)
        >>> tracks, valid, _ = step(flow=flow, flow_valid=is_return, icp_transform=no_motion)
        >>> tracks[0, 0], valid[0, 0]
        (tensor([1., 0., 1., 0.]), tensor([False,  True]))

    Reference:
        Not in the paper; see :func:`navrl.ops.tracking.track_groups`.
    """

    TRANSFORM, PAST = 2, 2

    def __init__(
        self,
        num_scans: int = 5,
        num_groups: int = 30,
        radius: float = 0.6,
        gate: float = 0.7,
        max_rms: float = 0.5,
        max_range: float = 3.5,
        in_keys: Keys = (keys.FLOW, keys.FLOW_VALID, keys.ICP_TRANSFORM),
        out_keys: Keys = (keys.TRACKS, keys.TRACKS_VALID, keys.TRACKS_POINTS),
    ) -> None:
        """Check the arguments."""
        super().__init__(in_keys, out_keys, num_scans)
        if len(self.in_keys) != 3 or len(self.out_keys) != 3:
            raise ValueError(
                f"TrackFlow: in_keys={self.in_keys}, out_keys={self.out_keys}: must be three each "
                "(flow, its validity, transform; tracks, their validity, past points)"
            )
        check_tracking(num_groups, radius, gate, max_rms, max_range)
        self.options = {
            "num_groups": num_groups,
            "radius": radius,
            "gate": gate,
            "max_rms": max_rms,
            "max_range": max_range,
        }

    def _latest(self, tensordict: TensorDictBase) -> Tensor:
        points, moving = self._moving(tensordict)
        return torch.where(moving.unsqueeze(-1), points, FAR)

    def _initial(self, tensordict: TensorDictBase) -> Tensor:
        """Return no past."""
        latest = self._latest(tensordict).unsqueeze(-3)
        return torch.full_like(latest, FAR).repeat_interleave(self.num_scans, dim=-3)

    def _write(self, tensordict: TensorDictBase, past: Tensor) -> TensorDictBase:
        is_near = past.square().sum(-1, keepdim=True) < FAR**2  # far ones have moved with the robot
        past = torch.where(is_near, past.float(), FAR)
        points, moving = self._moving(tensordict)
        with torch.autocast(points.device.type, enabled=False):
            tracks, valid = track_groups(points, moving, past, **self.options)
        for key, value in zip(self.out_keys, (tracks, valid, past), strict=True):
            tensordict.set(key, value)
        return tensordict

    def _moving(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return the present points ``[*B, N, 2]`` m and which of them move ``[*B, N]``."""
        before, now = read(self, tensordict, self.in_keys[0]).float().split(2, dim=-1)
        valid = read(self, tensordict, self.in_keys[1]).all(-1)
        return now, valid & (before != now).any(-1)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the specs of the tracks and the past scans to those of the environment."""
        observation_spec = super().transform_observation_spec(observation_spec)
        flow = read_spec(self, observation_spec, self.in_keys[0])
        shape = (*flow.shape[:-2], self.options["num_groups"])
        observation_spec[self.out_keys[0]] = real_spec(flow, *shape, 4)
        observation_spec[self.out_keys[1]] = flag_spec(flow, *shape, 2)
        return observation_spec
