"""Several past scans as ranges in the current robot frame."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec

from navrl import keys
from navrl.checks import check_counts, check_positive
from navrl.ops.projection import project_ranges
from navrl.transforms.aligned_history import AlignedHistory
from navrl.transforms.observation_map import Keys, read, read_spec


class RangeHistory(AlignedHistory):
    """Transform past scans to the current frame and project them to ranges by bearing.

    Static obstacles have the same position in all scans, independent of the robot's motion; moving
    obstacles do not. A convolution over beams with the scans as channels can detect the difference.

    As in :class:`navrl.transforms.ScanHistory` the past is stored in the TensorDict. After a reset
    there is no past and the current scan replaces it.

    Args:
        num_scans: Number of past scans K.
        group_size: That of the :class:`navrl.transforms.MinPool` before, which determines the
            bearings of the bins.
        max_range: Range of the sensor, m.
        in_keys: Points ``[*B, N, 2]`` m of scan t, those without a return at ``max_range``, and
            T_target_source ``[*B, 3]`` of frame t-1 in frame t; optionally the bins covered by the
            lidar ``[*B, N]`` bool. Uncovered bins are excluded from past scans instead of being
            treated as free.
        out_keys: Past points ``[*B, K, N, 2]`` m in frame t, scan t-1 first, and all ranges
            ``[*B, K + 1, N]`` m, scan t first.

    Raises:
        ValueError: If an argument is not positive, a number of keys is wrong, or later if the
            environment lacks a key.

    Example:
        >>> history = RangeHistory(num_scans=2, group_size=None)
        >>> points, no_motion = torch.tensor([[[1.0, 0.1], [-2.0, -0.1]]]), torch.zeros(1, 3)
        >>> past_points, ranges = history(points=points, icp_transform=no_motion)
        >>> past_points.shape, ranges.shape
        (torch.Size([1, 2, 2, 2]), torch.Size([1, 3, 2]))

    Reference:
        Not in the paper, which compares two scans by descriptors; see
        :func:`navrl.ops.projection.project_ranges` for the projection.
    """

    TRANSFORM, PAST = 1, 0

    def __init__(
        self,
        num_scans: int = 3,
        group_size: int | None = 8,
        max_range: float = 3.5,
        in_keys: Keys = (keys.POINTS, keys.ICP_TRANSFORM),
        out_keys: Keys = (keys.POINTS_HISTORY, keys.RANGES_HISTORY),
    ) -> None:
        super().__init__(in_keys, out_keys, num_scans)
        if len(self.in_keys) not in (2, 3) or len(self.out_keys) != 2:
            raise ValueError(
                f"RangeHistory: in_keys={self.in_keys}, out_keys={self.out_keys}: must be two each "
                "(points, transform; past points, ranges), and optionally seen in in_keys"
            )
        check_counts(group_size=group_size)
        check_positive(max_range=max_range)
        self.group_size = group_size
        self.max_range = max_range

    def _latest(self, tensordict: TensorDictBase) -> Tensor:
        return read(self, tensordict, self.in_keys[0])

    def _initial(self, tensordict: TensorDictBase) -> Tensor:
        """Fill the missing past with the current scan."""
        return self._latest(tensordict).unsqueeze(-3).repeat_interleave(self.num_scans, dim=-3)

    def _write(self, tensordict: TensorDictBase, past: Tensor) -> TensorDictBase:
        now = torch.linalg.vector_norm(read(self, tensordict, self.in_keys[0]), dim=-1)
        now = now.clamp(max=self.max_range).unsqueeze(-2)
        covered = past
        if len(self.in_keys) == 3:  # points retain their order, so the mask applies to past scans
            seen = read(self, tensordict, self.in_keys[2])[..., None, :, None]
            covered = torch.where(seen, past, torch.nan)
        past_ranges = project_ranges(covered, now, self.group_size, self.max_range)
        tensordict.set(self.out_keys[0], past)
        tensordict.set(self.out_keys[1], torch.cat([now, past_ranges], dim=-2))
        return tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the specs of the past scans to those of the environment."""
        observation_spec = super().transform_observation_spec(observation_spec)
        points = read_spec(self, observation_spec, self.in_keys[0])
        *batch, num_points, _ = points.shape
        observation_spec[self.out_keys[1]] = Bounded(
            0.0,
            self.max_range,
            torch.Size((*batch, self.num_scans + 1, num_points)),
            dtype=torch.float32,
            device=points.device,
        )
        return observation_spec
