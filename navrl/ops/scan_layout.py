"""Bearings of lidar beams in the robot frame and their assignment to bearing bins."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from navrl.checks import check_angles, check_counts, check_pose, is_finite
from navrl.deprecation import renamed_attributes

TWO_PI = 2.0 * math.pi
# Drivers round angles, so the beams of a revolution may differ from an integer by this many beams.
_ROUNDING = 0.01


@dataclass(frozen=True)
class ScanLayout:
    """Beam layout of a planar scan and the bearing bins into which its beams are pooled.

    Beam j points at ``angle_min + j * angle_increment`` in the scanner's frame. The bins divide the
    full circle around the robot evenly, independent of the scanner's field of view; bin 0 begins
    half a beam to the right of straight ahead and bins are numbered counter-clockwise.

    Args:
        num_beams: Number of beams in a scan.
        group_size: Beams per bin, which must divide the beams of a revolution; None with
            ``num_points``.
        num_points: Number of bins N; None derives it from ``group_size``.
        angle_min: Bearing of beam 0 in the scanner's frame, rad.
        angle_increment: Angle from one beam to the next, rad, negative for clockwise order; None
            spreads the beams evenly over a full circle, counter-clockwise.
        mount: (x, y, yaw) of the scanner in the robot frame, m and rad.

    Raises:
        ValueError: If an argument is invalid; the message names it.

    Example:
        >>> front = ScanLayout(num_beams=3, group_size=None, num_points=4, angle_min=-math.pi / 2,
        ...                    angle_increment=math.pi / 2)
        >>> front.seen()
        tensor([ True,  True, False,  True])
    """

    num_beams: int
    group_size: int | None = 8
    num_points: int | None = None
    angle_min: float = 0.0
    angle_increment: float | None = None
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_layout(
            self.group_size, self.num_points, self.angle_min, self.angle_increment, self.mount
        )
        check_counts(num_beams=self.num_beams)
        covered = (self.num_beams - 1) * abs(self.increment)
        if covered > TWO_PI * (1.0 + 1e-5):
            raise ValueError(
                f"angle_increment={self.angle_increment}: must be within one revolution, got "
                f"{covered:.3f} rad between the first and last of {self.num_beams} beams"
            )
        if self.group_size is not None:
            self._check_groups(self.group_size)

    def _check_groups(self, group_size: int) -> None:
        whole = round(self.revolution)
        if abs(self.revolution - whole) > _ROUNDING or whole % group_size:
            raise ValueError(
                f"group_size={group_size}: must divide the beams of a revolution: "
                f"{self.revolution:.6g} beams, group_size {group_size}; for N bins of any "
                "number of beams set group_size=None and num_points=N"
            )
        made = whole // group_size
        if self.num_points is not None and self.num_points != made:
            raise ValueError(
                f"num_points={self.num_points}: must be {made} for group_size={group_size} "
                f"and {whole} beams; use a lidar of {self.num_points * group_size} beams or "
                "set group_size=None"
            )

    @property
    def increment(self) -> float:
        """Angle from one beam to the next, rad."""
        return TWO_PI / self.num_beams if self.angle_increment is None else self.angle_increment

    @property
    def revolution(self) -> float:
        """Number of beams in a full circle at this increment."""
        return TWO_PI / abs(self.increment)

    @property
    def num_bins(self) -> int:
        """Number of bins N."""
        if self.group_size is not None:
            return round(self.revolution) // self.group_size
        assert self.num_points is not None  # see check_layout
        return self.num_points

    @property
    def is_plain(self) -> bool:
        """Return whether consecutive beams fill the bins in order, as in simulated scans."""
        full = self.group_size is not None and self.num_beams == self.num_bins * self.group_size
        return full and (*self.mount, self.angle_min) == (0.0,) * 4 and self.increment > 0.0

    def beam_bearings(self) -> Tensor:
        """Return the direction of each beam in the robot frame, ``[num_beams]`` float64 rad."""
        beam = torch.arange(self.num_beams, dtype=torch.float64)
        return self.mount[2] + self.angle_min + beam * self.increment

    def bin_of(self, bearings: Tensor) -> Tensor:
        """Return the bin index (int64) of each bearing in the robot frame, rad, any shape."""
        half_beam = 0.5 * abs(self.increment)
        index = torch.floor((bearings + half_beam) * (self.num_bins / TWO_PI)).long()
        return index.remainder(self.num_bins)

    def bin_centers(self, dtype: torch.dtype, device: torch.device | str = "cpu") -> Tensor:
        """Return the bearing of each bin's center, ``[N]`` rad."""
        if self.group_size is not None:
            return bin_centers(self.num_bins * self.group_size, self.group_size, dtype, device)
        centers = (torch.arange(self.num_bins, dtype=torch.float64) + 0.5) * (
            TWO_PI / self.num_bins
        )
        return (centers - 0.5 * abs(self.increment)).to(device, dtype)

    def beams_by_bin(self) -> Tensor:
        """Return the beams of each bin, ``[N, M]`` int64 ascending, padded with ``num_beams``."""
        return _beams_by_bin(self)

    def fullest_bin(self) -> int:
        """Return the number of beams in the bin that has the most."""
        return _fullest_bin(self)

    def seen(self) -> Tensor:
        """Return whether each bin is covered by a beam, ``[N]`` bool.

        For an off-center scanner the coverage is evaluated at an infinite range; nearer returns may
        be in other bins.
        """
        return (self.beams_by_bin() < self.num_beams).any(-1)


def check_layout(
    group_size: int | None,
    num_points: int | None,
    angle_min: float,
    angle_increment: float | None,
    mount: Sequence[float],
) -> None:
    """Check the arguments of :class:`ScanLayout`, apart from the number of beams.

    Raises:
        ValueError: If an argument is out of range; the message names it.
    """
    if group_size is None and num_points is None:
        raise ValueError("group_size=None: must be a number of beams unless num_points is given")
    check_counts(group_size=group_size, num_points=num_points)
    check_scan_angles(angle_min, angle_increment)
    check_pose("mount", mount)


def check_scan_angles(angle_min: float, angle_increment: float | None) -> None:
    """Check the angles of a scan's beams.

    Raises:
        ValueError: If an angle is not in rad, or the increment is 0; the message names it.
    """
    check_angles(angle_min=angle_min)
    if angle_increment is not None and not (is_finite(angle_increment) and angle_increment):
        raise ValueError(f"angle_increment={angle_increment!r}: must be finite and not 0 (rad)")


@functools.lru_cache(maxsize=64)
def scan_layout(
    num_beams: int,
    group_size: int | None = 8,
    num_points: int | None = None,
    angle_min: float = 0.0,
    angle_increment: float | None = None,
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> ScanLayout:
    """Return a cached :class:`ScanLayout` of these arguments, validated once.

    Example:
        >>> scan_layout(1440, 8) is scan_layout(1440, 8)
        True
    """
    return ScanLayout(num_beams, group_size, num_points, angle_min, angle_increment, mount)


@functools.lru_cache(maxsize=64)
def _fullest_bin(layout: ScanLayout) -> int:
    return int(layout.bin_of(layout.beam_bearings()).bincount().max())


@functools.lru_cache(maxsize=16)
def _beams_by_bin(layout: ScanLayout) -> Tensor:
    index = layout.bin_of(layout.beam_bearings())
    count = torch.bincount(index, minlength=layout.num_bins)
    order = torch.argsort(index, stable=True)
    first = (count.cumsum(0) - count)[index[order]]
    table = torch.full((layout.num_bins, int(count.max())), layout.num_beams)
    table[index[order], torch.arange(layout.num_beams) - first] = order
    return table


def bin_centers(
    num_beams: int,
    group_size: int,
    dtype: torch.dtype,
    device: torch.device | str = "cpu",
) -> Tensor:
    """Return the center of each bin of ``group_size`` evenly spaced beams, ``[N]`` rad.

    Example:
        >>> bin_centers(num_beams=4, group_size=2, dtype=torch.float32)  # 45 and 225 degrees
        tensor([0.7854, 3.9270])
    """
    first_beam = torch.arange(0, num_beams, group_size, device=device, dtype=dtype)
    return (first_beam + 0.5 * (group_size - 1)) * (TWO_PI / num_beams)


__getattr__ = renamed_attributes(__name__, {"TURN": "TWO_PI"})
