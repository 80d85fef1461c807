"""Min-pooling of raw lidar beams to ranges and points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import Bounded, TensorSpec
from torchrl.envs import Compose, Transform

from navrl import keys
from navrl.ops.beams import Bearing
from navrl.ops.pooling import check_pooling, min_pool
from navrl.ops.scan_layout import ScanLayout, check_layout, scan_layout
from navrl.ops.scanner import Scanner
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec
from navrl.transforms.scan_adapter import ScanAdapter

if TYPE_CHECKING:
    from navrl.sim import Lidar

_MAX_TABLE = 10_000_000  # entries, bins times the beams of the fullest one


class MinPool(ObservationMap):
    """Reduce a scan to the nearest return in each of N equal bearing bins, as range and point.

    The bins always cover the full circle around the robot. Bins without beams (a 270 degree
    scanner) have no return; ``seen``, an optional fourth output, distinguishes them from free bins.
    Readings of a scanner with any mount become ranges and points in the robot frame.

    Args:
        group_size: Beams per bin; must divide the beams of a revolution. None with ``num_points``.
        max_range: Range of the sensor, m; a reading at or beyond it, not finite, or not positive
            is no return.
        bearing: ``"bin"`` places a point at the center bearing of its bin, ``"beam"`` at the
            bearing of the beam that measured it.
        num_points: Required number of points N, for networks of a fixed input size; None for any.
            With ``group_size=None`` it sets N, which need not divide the number of beams.
        angle_min: Bearing of beam 0 in the scanner's frame, rad.
        angle_increment: Angle from one beam to the next, rad, negative for clockwise order; None
            for beams over a full circle, counter-clockwise.
        mount: (x, y, yaw) of the scanner in the robot frame, m and rad.
        in_keys: Ranges ``[*B, beams]`` m, beam j at ``angle_min + j * angle_increment``; optionally
            the beams that measure ``[*B, beams]`` bool, for ``seen`` of a lidar with blind beams.
        out_keys: Pooled ranges ``[*B, N]`` m, points ``[*B, N, 2]`` m in the robot frame, and
            returns ``[*B, N]`` bool; optionally the covered bins ``[*B, N]`` bool. Ranges and
            points are float32, those of a float64 scan too.

    Raises:
        ValueError: If an argument is invalid, or if ``group_size`` does not divide the
            environment's number of beams or results in another number of points.

    Example:
        >>> pool = MinPool(group_size=2)
        >>> ranges, points, returns = pool(ranges=torch.tensor([[1.0, 2.0, 3.5, 3.5]]))
        >>> ranges, returns
        (tensor([[1.0000, 3.5000]]), tensor([[ True, False]]))

    Reference:
        Paper Sec. IV-C and IV-G; see :func:`navrl.ops.pooling.min_pool`.
    """

    INPUTS = ("ranges",)
    OPTIONAL_INPUTS = ("measured",)
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
        self.max_range = max_range
        self.bearing: Bearing = bearing
        self.angle_min, self.angle_increment = angle_min, angle_increment
        self.mount = tuple(float(value) for value in mount)

    def layout(self, num_beams: int) -> ScanLayout:
        """Return the bearings and bins of a scan of ``num_beams`` beams.

        Raises:
            ValueError: If the number of beams does not match this pooling.
        """
        angles = (self.angle_min, self.angle_increment, self.mount)
        return scan_layout(num_beams, self.group_size, self.num_points, *angles)

    def map_values(self, ranges: Tensor, measured: Tensor | None = None) -> Sequence[Tensor]:
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
        layout = self.layout(ranges.shape[-1])
        if measured is None:
            seen = layout.seen().to(ranges.device)
            return (*pooled, seen | pooled.returns)  # an off-center scanner: returns elsewhere
        none = measured.new_zeros((*measured.shape[:-1], 1))  # entry of the table's padding
        beams = layout.beams_by_bin().to(ranges.device)
        seen = torch.cat((measured, none), dim=-1)[..., beams].any(-1)
        return (*pooled, seen | pooled.returns)

    def map_specs(
        self, ranges: TensorSpec, measured: TensorSpec | None = None
    ) -> Sequence[TensorSpec]:
        """Return the specs of pooled ranges, points, returns and, if requested, seen.

        Raises:
            ValueError: If the number of beams does not match this pooling.
        """
        try:
            num_points = self._checked_bins(ranges.shape[-1])
        except ValueError as error:
            raise ValueError(f"MinPool on key {self.in_keys[0]!r}: {error}") from None
        shape = torch.Size((*ranges.shape[:-1], num_points))
        kind = {"dtype": torch.float32, "device": ranges.device}
        flags = [flag_spec(ranges, *shape) for _ in self.out_keys[2:]]
        return (
            Bounded(0.0, self.max_range, shape, **kind),
            Bounded(-self.max_range, self.max_range, torch.Size((*shape, 2)), **kind),
            *flags,
        )

    def _checked_bins(self, num_beams: int) -> int:
        """Return the number of bins; the table of each bin's beams is bounded before it is made."""
        layout = self.layout(num_beams)
        fullest = layout.fullest_bin()
        if layout.num_bins * fullest > _MAX_TABLE:
            raise ValueError(
                f"num_points={layout.num_bins} with {fullest} beams in one bin: "
                f"their product must be at most {_MAX_TABLE:,}"
            )
        return layout.num_bins


def check_lidar(transforms: Transform, lidar: Lidar) -> None:
    """Check that poolings and adapters of raw scans assume the mount and angles of the lidar.

    After a :class:`ScanAdapter` those are the mount and the angles to which it resamples.

    Args:
        transforms: A pipeline, or one step of it.
        lidar: The lidar whose scans are pooled.

    Raises:
        ValueError: If a step assumes others, so that its points would be off.
    """
    layouts: dict[NestedKey, Lidar | ScanLayout] = {keys.RANGES: lidar}
    for step in _readers(transforms):
        if isinstance(step, ScanAdapter):
            if step.in_keys[0] == keys.RANGES:
                _check_scanner(step.scanner, lidar)
            layouts[step.out_keys[0]] = step.target
        elif step.in_keys[0] in layouts:
            _check_pooling(step, layouts[step.in_keys[0]])


def _check_pooling(pool: MinPool, lidar: Lidar | ScanLayout) -> None:
    for name in ("mount", "angle_min", "angle_increment"):
        own, assumed = getattr(lidar, name), getattr(pool, name)
        if own != assumed:
            raise ValueError(
                f"lidar.{name}={_shown(own)}: must be the {name} of MinPool, which is "
                f"{_shown(assumed)}: set both, transforms.min_pool.{name} too"
            )


def _check_scanner(scanner: Scanner, lidar: Lidar) -> None:
    """Check that the scanner of an adapter is the lidar."""
    count = lidar.num_beams
    pairs = {
        "num_beams": (count, scanner.num_beams or count),
        "mount": (lidar.mount, scanner.mount),
        "angle_min": (lidar.angle_min, float(scanner.bearings(count)[0])),
        "angle_increment": (lidar.increment, scanner.increment(count)),
    }
    for name, (own, assumed) in pairs.items():
        if not np.allclose(own, assumed, rtol=0.0, atol=1e-9):
            raise ValueError(
                f"lidar.{name}={_shown(own)}: must be the {name} of the scanner of ScanAdapter, "
                f"which is {_shown(assumed)}: set both, transforms.scan_adapter.scanner.{name} too"
            )


def _shown(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def _readers(transforms: Transform) -> Iterator[MinPool | ScanAdapter]:
    if isinstance(transforms, (MinPool, ScanAdapter)):
        yield transforms
    elif isinstance(transforms, Compose):
        for step in transforms:
            yield from _readers(step)
