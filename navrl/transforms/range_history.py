"""Several past scans as ranges, each seen from where the robot is now."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import dispatch
from torch import Tensor
from torchrl.data import Bounded, Composite
from torchrl.envs import Transform

from navrl import keys
from navrl.ops import se2
from navrl.ops.projection import project_ranges
from navrl.transforms.observation_map import (
    Keys,
    map_reset_rows,
    nested_keys,
    read,
    read_spec,
    real_spec,
    refuse_without_past,
)


class RangeHistory(Transform):
    """Carry past scans from frame to frame and read them as ranges by bearing.

    What stands still is where it was in every scan, however the robot moved; what moved is not. A
    convolution over beams with the scans as channels sees that difference at once.

    As in :class:`navrl.transforms.ScanHistory` the past lives in the TensorDict. At a reset there
    is none, and the present stands in for it.

    Args:
        num_scans: Past scans K.
        group_size: Beams in a bin of the min-pooling, which says where the bearings are; None if
            it is None there.
        max_range: Range of the sensor, m.
        in_keys: Points ``[*B, N, 2]`` m of scan t, those without return at ``max_range``, and
            T_target_source ``[*B, 3]`` of frame t-1 in frame t; optionally the bins that the
            lidar covers ``[*B, N]`` bool. The others say nothing of the past: not that it was free.
        out_keys: Past points ``[*B, K, N, 2]`` m in frame t, scan t-1 first, and all ranges
            ``[*B, K + 1, N]`` m, scan t first.

    Raises:
        ValueError: If an argument is not positive, a number of keys is not two, or later if the
            environment lacks a key.

    Reference:
        Not in the paper, which compares two scans in descriptors; see
        :func:`navrl.ops.projection.project_ranges` for how a past scan is read.
    """

    def __init__(
        self,
        num_scans: int = 3,
        group_size: int | None = 8,
        max_range: float = 3.5,
        in_keys: Keys = (keys.POINTS, keys.ICP_TRANSFORM),
        out_keys: Keys = (keys.POINTS_HISTORY, keys.RANGES_HISTORY),
    ) -> None:
        super().__init__(in_keys=nested_keys(in_keys), out_keys=nested_keys(out_keys))
        if len(self.in_keys) not in (2, 3) or len(self.out_keys) != 2:
            raise ValueError(
                f"RangeHistory: in_keys (points, transform) and out_keys (past points, ranges) "
                f"must be two each, and optionally seen in in_keys, got {self.in_keys} and "
                f"{self.out_keys}"
            )
        if num_scans < 1 or (group_size is not None and group_size < 1) or not max_range > 0.0:
            raise ValueError(
                f"RangeHistory: num_scans={num_scans}, group_size={group_size}: must be >= 1; "
                f"max_range={max_range}: must be > 0"
            )
        self.num_scans = num_scans
        self.group_size = group_size
        self.max_range = max_range

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        points_key, transform_key = self.in_keys[:2]
        latest = read(self, tensordict, points_key).unsqueeze(-3)
        older = read(self, tensordict, self.out_keys[0])[..., :-1, :, :]
        past = torch.cat([latest, older], dim=-3)
        transform = read(self, next_tensordict, transform_key).unsqueeze(-2)
        return self._write(next_tensordict, se2.transform_points(transform, past))

    def _call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Let the present stand in for a past that does not exist."""
        points = read(self, tensordict, self.in_keys[0]).unsqueeze(-3)
        past = points.repeat_interleave(self.num_scans, dim=-3)
        return self._write(tensordict, past)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return map_reset_rows(self, tensordict, tensordict_reset)

    def _write(self, tensordict: TensorDictBase, past: Tensor) -> TensorDictBase:
        now = torch.linalg.vector_norm(read(self, tensordict, self.in_keys[0]), dim=-1)
        now = now.clamp(max=self.max_range).unsqueeze(-2)
        covered = past
        if len(self.in_keys) == 3:  # the order of points is kept, so a past one is in the same bin
            seen = read(self, tensordict, self.in_keys[2])[..., None, :, None]
            covered = torch.where(seen, past, torch.nan)
        past_ranges = project_ranges(covered, now, self.group_size, self.max_range)
        tensordict.set(self.out_keys[0], past)
        tensordict.set(self.out_keys[1], torch.cat([now, past_ranges], dim=-2))
        return tensordict

    @dispatch(source="in_keys", dest="out_keys", auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Restore the past of stored data.

        Under ``"next"`` it follows from the root's, also at the end of an episode. At the root a
        stored past is kept. Without one, data without ``"next"`` is of first scans, for which the
        present stands in; a transition is refused.

        Raises:
            ValueError: If the root of a transition lacks its past.
        """
        missing = [key for key in self.out_keys if key not in tensordict.keys(True, True)]
        if missing:
            refuse_without_past(self, tensordict, missing)
            self._call(tensordict)
        if "next" in tensordict:
            self._step(tensordict, tensordict["next"])
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Return the environment's specs with those of the past added."""
        points = read_spec(self, observation_spec, self.in_keys[0])
        *batch, num_points, _ = points.shape
        observation_spec = observation_spec.clone()
        observation_spec[self.out_keys[0]] = real_spec(
            points, *batch, self.num_scans, num_points, 2
        )
        observation_spec[self.out_keys[1]] = Bounded(
            0.0,
            self.max_range,
            (*batch, self.num_scans + 1, num_points),
            dtype=torch.float32,
            device=points.device,
        )
        return observation_spec

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Declare that a step reads the present and its past from its caller."""
        input_spec = input_spec.clone()
        observation_spec = self.parent.full_observation_spec
        points = read_spec(self, observation_spec, self.in_keys[0])
        *batch, num_points, _ = points.shape
        state = input_spec["full_state_spec"]
        state[self.in_keys[0]] = points.clone()
        state[self.out_keys[0]] = real_spec(points, *batch, self.num_scans, num_points, 2)
        return input_spec
