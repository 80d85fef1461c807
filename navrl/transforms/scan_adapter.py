"""Transform that resamples the scans of any lidar to the beams of a policy."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from navrl import keys
from navrl.checks import check_positive
from navrl.ops.scan_adapter import adapt_scan
from navrl.ops.scan_layout import ScanLayout
from navrl.ops.scanner import BeamState, Scanner
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec


class ScanAdapter(ObservationMap):
    """Resample a lidar's scan to the beams that a policy was trained with, by bearing.

    The outputs are those of a simulated lidar: a free direction and one that is not seen read
    ``max_range``, and the second output distinguishes them, as ``measured`` does for a lidar with
    blind beams. The step belongs before :class:`navrl.transforms.MinPool`, whose optional input
    ``measured`` makes ``seen`` of it.

    Args:
        scanner: Angles, mount and readings of the lidar.
        num_beams: Number of beams of the result.
        max_range: Range of the policy's lidar, m.
        angle_min: Angle of beam 0 of the result, rad.
        angle_increment: Angle between beams of the result, rad; None for a full circle.
        mount: (x, y, yaw) of the policy's lidar in the robot frame, m and rad.
        in_keys: Readings ``[*B, M]`` m of any number of beams; optionally the motion
            ``[*B, 2, 3]`` (m, m, rad) of the robot's frames at the first and last beam, in its
            present frame.
        out_keys: Ranges ``[*B, num_beams]`` m and seen beams ``[*B, num_beams]`` bool.

    Raises:
        ValueError: If an argument is invalid, or later if a scan exceeds a full circle.

    Example:
        >>> import math
        >>> front = Scanner(angle_min=-1.57, angle_increment=1.57, max_beam_width=1.57)
        >>> adapter = ScanAdapter(front, num_beams=4)
        >>> ranges, measured = adapter(ranges=torch.tensor([[2.0, 1.0, math.inf]]))
        >>> ranges, measured
        (tensor([[1.0000, 3.5000, 3.5000, 2.0000]]), tensor([[ True,  True, False,  True]]))

    Reference:
        Not in the paper, whose lidar has the beams of the policy.
    """

    INPUTS = ("readings",)
    OPTIONAL_INPUTS = ("motion",)
    OUTPUTS = ("ranges", "measured")

    def __init__(
        self,
        scanner: Scanner,
        num_beams: int = 1440,
        max_range: float = 3.5,
        angle_min: float = 0.0,
        angle_increment: float | None = None,
        mount: Sequence[float] = (0.0, 0.0, 0.0),
        in_keys: Keys = (keys.RANGES,),
        out_keys: Keys = (keys.RANGES, keys.MEASURED),
    ) -> None:
        """Check and store the arguments."""
        super().__init__(in_keys, out_keys)
        check_positive(max_range=max_range)
        x, y, yaw = (float(value) for value in mount)
        self.target = ScanLayout(num_beams, None, 1, angle_min, angle_increment, (x, y, yaw))
        self.scanner, self.max_range = scanner, max_range

    def map_values(self, readings: Tensor, motion: Tensor | None = None) -> Sequence[Tensor]:
        """Resample ``readings``; see :func:`navrl.ops.scan_adapter.adapt_scan`."""
        scan = adapt_scan(readings, self.scanner, self.target, motion)
        ranges = scan.ranges.nan_to_num(self.max_range).clamp(max=self.max_range)
        return ranges, scan.states != BeamState.NOT_SEEN

    def map_specs(
        self, readings: TensorSpec, motion: TensorSpec | None = None
    ) -> Sequence[TensorSpec]:
        """Return the specs of ranges and seen beams.

        Raises:
            ValueError: If the beams of the scan exceed a full circle.
        """
        self.scanner.increment(readings.shape[-1])
        shape = torch.Size((*readings.shape[:-1], self.target.num_beams))
        ranges = Bounded(0.0, self.max_range, shape, dtype=torch.float32, device=readings.device)
        return ranges, flag_spec(readings, *shape)
