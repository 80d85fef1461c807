"""From raw beams to a few points."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from navrl import keys
from navrl.ops.pooling import Bearing, check_pooling, min_pool
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec


class MinPool(ObservationMap):
    """Keep the nearest return of each bin of neighbouring beams, as range and as point.

    Args:
        group_size: Beams in a bin; must divide the number of beams, which is free.
        max_range: Range of the sensor, m; a reading at or beyond it, not finite, or not positive
            is no return.
        bearing: ``"bin"`` draws a point at its bin's centre angle, ``"beam"`` at the angle of the
            beam that measured it.
        num_points: Points N that must come out, for networks made for as many; None for any.
        in_keys: Ranges ``[*B, beams]`` m, beam j at ``2*pi*j/beams`` from straight ahead.
        out_keys: Pooled ranges ``[*B, N]`` m, points ``[*B, N, 2]`` m in the robot frame, and
            which of them are returns ``[*B, N]`` bool.

    Raises:
        ValueError: If an argument is not as above, or if ``group_size`` does not divide the
            environment's number of beams or makes another number of points of them.

    Reference:
        Paper Sec. IV-C and IV-G; see :func:`navrl.ops.pooling.min_pool`.
    """

    INPUTS = ("ranges",)
    OUTPUTS = ("pooled ranges", "points", "returns")

    def __init__(
        self,
        group_size: int = 8,
        max_range: float = 3.5,
        bearing: Bearing = "bin",
        num_points: int | None = None,
        in_keys: Keys = (keys.RANGES,),
        out_keys: Keys = (keys.RANGES_POOLED, keys.POINTS, keys.RETURNS),
    ) -> None:
        super().__init__(in_keys, out_keys)
        check_pooling(torch.Size([max(1, group_size)]), group_size, max_range, bearing)
        self.group_size = group_size
        self.max_range = max_range
        self.bearing = bearing
        self.num_points = num_points

    def map_values(self, ranges: Tensor) -> Sequence[Tensor]:
        """Pool ``ranges``; see :func:`navrl.ops.pooling.min_pool`."""
        return min_pool(ranges.float(), self.group_size, self.max_range, self.bearing)

    def map_specs(self, ranges: TensorSpec) -> Sequence[TensorSpec]:
        """Return the specs of pooled ranges, points and returns."""
        try:
            check_pooling(ranges.shape, self.group_size, self.max_range, self.bearing)
        except ValueError as error:
            raise ValueError(f"MinPool on key {self.in_keys[0]!r}: {error}") from None
        num_points = ranges.shape[-1] // self.group_size
        if self.num_points not in (None, num_points):
            raise ValueError(
                f"MinPool on key {self.in_keys[0]!r}: num_points={self.num_points}: group_size="
                f"{self.group_size} makes {num_points} of {ranges.shape[-1]} beams; it needs a "
                f"lidar of {self.num_points * self.group_size} beams"
            )
        shape = (*ranges.shape[:-1], num_points)
        kind = {"dtype": torch.float32, "device": ranges.device}
        return (
            Bounded(0.0, self.max_range, shape, **kind),
            Bounded(-self.max_range, self.max_range, (*shape, 2), **kind),
            flag_spec(ranges, *shape),
        )
