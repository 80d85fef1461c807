"""From raw beams to a few points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec
from torchrl.envs import Compose, Transform

from navrl import keys
from navrl.ops.beams import Bearing
from navrl.ops.pooling import check_pooling, min_pool
from navrl.ops.scan_layout import ScanLayout, check_layout, scan_layout
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec

if TYPE_CHECKING:
    from navrl.sim import Lidar

_MAX_TABLE = 10_000_000  # entries, bins times the beams of the fullest one


class MinPool(ObservationMap):
    """Keep the nearest return of each of N equal bins of bearings, as range and as point.

    The bins cover the full circle around the robot in any case. Bins that no beam points into (a
    scanner of 270 degrees) have no return; ``seen``, if a fourth out_key asks for it, tells them
    from free ones. Readings, of any mount, become ranges and points of the robot's own frame.

    Args:
        group_size: Beams in a bin; must divide the beams of a revolution. None with ``num_points``.
        max_range: Range of the sensor, m; a reading at or beyond it, not finite, or not positive
            is no return.
        bearing: ``"bin"`` draws a point at its bin's center angle, ``"beam"`` at the angle of the
            beam that measured it.
        num_points: Points N that must come out, for networks made for as many; None for any. With
            ``group_size=None`` it sets them, and need not divide the beams.
        angle_min: Bearing of beam 0 in the scanner's frame, rad.
        angle_increment: From one beam to the next, rad, negative if they are counted clockwise;
            None for beams over a full circle, counter-clockwise.
        mount: (x, y, yaw) of the scanner in the robot frame, m and rad.
        in_keys: Ranges ``[*B, beams]`` m, beam j at ``angle_min + j * angle_increment``.
        out_keys: Pooled ranges ``[*B, N]`` m, points ``[*B, N, 2]`` m in the robot frame, and
            which of them are returns ``[*B, N]`` bool; optionally which bins are seen ``[*B, N]``.

    Raises:
        ValueError: If an argument is not as above, or if ``group_size`` does not divide the
            environment's number of beams or makes another number of points of them.

    Reference:
        Paper Sec. IV-C and IV-G; see :func:`navrl.ops.pooling.min_pool`.
    """

    INPUTS = ("ranges",)
    OUTPUTS = ("pooled ranges", "points", "returns")
    OPTIONAL_OUTPUTS = ("seen",)

    def __init__(
        self,
        group_size: int | None = 8,
        max_range: float = 3.5,
        bearing: Bearing = "bin",
        num_points: int | None = None,
        angle_min: float = 0.0,
        angle_increment: float | None = None,
        mount: Sequence[float] = (0.0, 0.0, 0.0),
        in_keys: Keys = (keys.RANGES,),
        out_keys: Keys = (keys.RANGES_POOLED, keys.POINTS, keys.RETURNS),
    ) -> None:
        super().__init__(in_keys, out_keys)
        check_pooling(max_range, bearing)
        check_layout(group_size, num_points, angle_min, angle_increment, mount)
        self.group_size, self.num_points = group_size, num_points
        self.max_range, self.bearing = max_range, bearing
        self.angle_min, self.angle_increment = angle_min, angle_increment
        self.mount = tuple(float(value) for value in mount)

    def layout(self, num_beams: int) -> ScanLayout:
        """Return the bearings and bins of a scan of ``num_beams`` beams.

        Raises:
            ValueError: If the beams do not fit this pooling.
        """
        angles = (self.angle_min, self.angle_increment, self.mount)
        return scan_layout(num_beams, self.group_size, self.num_points, *angles)

    def map_values(self, ranges: Tensor) -> Sequence[Tensor]:
        """Pool ``ranges``; see :func:`navrl.ops.pooling.min_pool`."""
        pooled = min_pool(
            ranges.float(),
            self.group_size,
            self.max_range,
            self.bearing,
            num_points=self.num_points,
            angle_min=self.angle_min,
            angle_increment=self.angle_increment,
            mount=self.mount,
        )
        if len(self.out_keys) == len(self.OUTPUTS):
            return pooled
        seen = self.layout(ranges.shape[-1]).seen().to(ranges.device)
        return (*pooled, seen.expand(pooled.returns.shape).clone())

    def map_specs(self, ranges: TensorSpec) -> Sequence[TensorSpec]:
        """Return the specs of pooled ranges, points, returns and, if asked for, seen."""
        try:
            num_points = self._checked_bins(ranges.shape[-1])
        except ValueError as error:
            raise ValueError(f"MinPool on key {self.in_keys[0]!r}: {error}") from None
        shape = (*ranges.shape[:-1], num_points)
        kind = {"dtype": torch.float32, "device": ranges.device}
        flags = [flag_spec(ranges, *shape) for _ in self.out_keys[2:]]
        return (
            Bounded(0.0, self.max_range, shape, **kind),
            Bounded(-self.max_range, self.max_range, (*shape, 2), **kind),
            *flags,
        )

    def _checked_bins(self, num_beams: int) -> int:
        """Return the number of bins; the table of each bin's beams is bounded before it is made."""
        layout = self.layout(num_beams)
        fullest = int(layout.bin_of(layout.beam_bearings()).bincount().max())
        if layout.num_bins * fullest > _MAX_TABLE:
            raise ValueError(
                f"num_points={layout.num_bins} with {fullest} beams in one bin: "
                f"their product must be at most {_MAX_TABLE:,}"
            )
        return layout.num_bins


def check_lidar(transforms: Transform, lidar: Lidar) -> None:
    """Check that poolings of raw scans assume the mount and the angles of the lidar.

    Args:
        transforms: A pipeline, or one step of it.
        lidar: The lidar whose scans are pooled.

    Raises:
        ValueError: If a pooling assumes others, so that its points would be off.
    """
    for pool in _poolings(transforms):
        if keys.RANGES not in pool.in_keys:
            continue
        for name in ("mount", "angle_min", "angle_increment"):
            own, assumed = getattr(lidar, name), getattr(pool, name)
            if own != assumed:
                raise ValueError(
                    f"lidar.{name}={_shown(own)}: must be the {name} of MinPool, which is "
                    f"{_shown(assumed)}: set both, transforms.min_pool.{name} too"
                )


def _shown(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def _poolings(transforms: Transform) -> Iterator[MinPool]:
    if isinstance(transforms, MinPool):
        yield transforms
    elif isinstance(transforms, Compose):
        for step in transforms:
            yield from _poolings(step)
