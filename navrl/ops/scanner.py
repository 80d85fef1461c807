"""Beam layout and readings of a lidar as its driver reports them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal

import torch
from torch import Tensor

from navrl.checks import (
    check_angles,
    check_counts,
    check_positive,
    checked_numbers,
    checked_pose,
    is_finite,
    is_real,
)
from navrl.ops.scan_layout import TWO_PI, check_scan_angles

__all__ = ["BeamState", "Scanner"]

Reading = Literal["too_near", "no_return", "invalid"]
"""Meaning of a reading that is not a distance."""

_OVERLAP = 0.02  # share of a circle by which rounded angles of a full circle may overlap
_BEYOND_M = 1.001  # m; drivers report no return as range_max, or as range_max + 1


class BeamState(IntEnum):
    """State of a direction after a scan; what was not seen is never free.

    - ``NOT_SEEN``: no valid beam covers the direction.
    - ``FREE``: a beam without a return covers it.
    - ``RETURN``: an obstacle was measured.
    - ``TOO_NEAR``: an obstacle is closer than the lidar's minimum range.
    """

    NOT_SEEN = 0
    FREE = 1
    RETURN = 2
    TOO_NEAR = 3


_STATES = {
    "too_near": BeamState.TOO_NEAR,
    "no_return": BeamState.FREE,
    "invalid": BeamState.NOT_SEEN,
}


@dataclass(frozen=True)
class Scanner:
    """Beam layout, mount and reading conventions of a planar lidar.

    Beam j points at ``angle_min + j * angle_increment`` in the scanner's frame, counter-clockwise.
    The number of beams is that of each scan and may change. A reading from ``range_max`` to 1 m
    beyond is no return; a larger finite one is invalid, e.g. a scan in millimeters.

    Args:
        angle_min: Angle of beam 0, rad.
        angle_increment: Angle from one beam to the next, rad, negative for clockwise order; None
            spreads the beams of each scan evenly over a full circle, counter-clockwise.
        mount: (x, y, yaw) of the scanner in the robot frame, m and rad.
        is_upside_down: Whether the scanner hangs upside down, so that its angles are mirrored.
        range_min: Smallest distance that it measures, m; also the distance of an obstacle that is
            too near.
        range_max: Largest distance that it measures, m.
        zero: Meaning of a reading of 0; ``"no_return"`` for drivers that write it for a miss.
        positive_infinity: Meaning of +inf; no return in REP 117.
        negative_infinity: Meaning of -inf; too near in REP 117.
        nan: Meaning of NaN; invalid in REP 117.
        below_range_min: Meaning of a positive reading below ``range_min``; the definition of
            sensor_msgs/LaserScan discards it.
        blind_sectors: (bearing, width) in the scanner's frame, rad, of sectors that parts of the
            robot cover; their beams are not seen.
        own_radius: Returns closer to the robot's center than this are parts of the robot, m, and
            their directions are not seen.
        max_beam_width: Largest angle that a beam stands for, rad; of a coarser scanner, directions
            between beams are not seen. 0.035 (2 deg): one bin of the shipped policies.
        revolution_s: Time from the first to the last beam, s, unless a scan has its own.
        num_beams: Nominal number of beams of a scan, for information.

    Raises:
        ValueError: If an argument is invalid; the message names it.

    Example:
        >>> front = Scanner(angle_min=-math.pi / 2, angle_increment=math.pi / 2, range_max=5.0)
        >>> front.bearings(3).tolist()
        [-1.5707963267948966, 0.0, 1.5707963267948966]
        >>> front.states(torch.tensor([1.0, math.inf, math.nan])).tolist()
        [2, 1, 0]

    Reference:
        REP 117 of ROS for the infinities and NaN.
    """

    angle_min: float = 0.0
    angle_increment: float | None = None
    mount: Sequence[float] = (0.0, 0.0, 0.0)
    is_upside_down: bool = False
    range_min: float = 0.0
    range_max: float = math.inf
    zero: Reading = "no_return"
    positive_infinity: Reading = "no_return"
    negative_infinity: Reading = "too_near"
    nan: Reading = "invalid"
    below_range_min: Reading = "invalid"
    blind_sectors: Sequence[Sequence[float]] = ()
    own_radius: float = 0.0
    max_beam_width: float = 0.035
    revolution_s: float = 0.0
    num_beams: int | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        check_counts(num_beams=self.num_beams)
        check_positive(max_beam_width=self.max_beam_width)
        check_scan_angles(self.angle_min, self.angle_increment)
        checked_pose("mount", self.mount)
        if self.is_upside_down not in (True, False):
            raise ValueError(f"is_upside_down={self.is_upside_down!r}: must be true or false")
        for name in ("range_min", "own_radius", "revolution_s"):
            value = getattr(self, name)
            if not (is_finite(value) and value >= 0.0):
                raise ValueError(f"{name}={value!r}: must be finite and >= 0")
        if not (is_real(self.range_max) and self.range_max > self.range_min):
            raise ValueError(
                f"range_max={self.range_max!r}: must be above range_min={self.range_min:g}"
            )
        for name in ("zero", "positive_infinity", "negative_infinity", "nan", "below_range_min"):
            value = getattr(self, name)
            if not isinstance(value, str) or value not in _STATES:
                raise ValueError(f"{name}={value!r}: must be one of {', '.join(_STATES)}")
        allowed = "a list of (bearing, width) in rad"
        sectors = checked_numbers("blind_sectors", self.blind_sectors, allowed)
        if sectors.size and (sectors.ndim != 2 or sectors.shape[1] != 2):
            raise ValueError(f"blind_sectors={self.blind_sectors}: must be {allowed}")
        for index, (bearing, width) in enumerate(sectors.reshape(-1, 2).tolist()):
            name = f"blind_sectors[{index}]"
            check_angles(**{f"{name}.bearing": bearing, f"{name}.width": width})

    def of_scan(
        self,
        num_beams: int,
        angle_min: float | None,
        angle_increment: float | None,
        range_min: float | None,
        range_max: float | None,
    ) -> Scanner:
        """Return the scanner with the angles and limits that came with a scan.

        Args:
            num_beams: Beams of the scan.
            angle_min: rad; ``None`` for that of the scanner, as of the others.
            angle_increment: rad.
            range_min: m; the larger one of both counts.
            range_max: m; the smaller one counts.

        Raises:
            ValueError: If a value is out of range or the beams exceed a full circle.

        Example:
            >>> Scanner(range_min=0.2).of_scan(360, -3.14, None, 0.1, 12.0).range_min
            0.2
        """
        given = {"angle_min": angle_min, "angle_increment": angle_increment}
        if range_min is not None:
            given["range_min"] = max(range_min, self.range_min) if is_real(range_min) else range_min
        if range_max is not None:
            given["range_max"] = min(range_max, self.range_max) if is_real(range_max) else range_max
        made = replace(self, **{k: v for k, v in given.items() if v is not None})
        made.increment(num_beams)
        return made

    def increment(self, num_beams: int) -> float:
        """Return the angle from one beam to the next, rad, in the order of the beams.

        Raises:
            ValueError: If ``num_beams`` is not positive or the beams exceed a full circle.
        """
        check_counts(num_beams=num_beams)
        step = TWO_PI / num_beams if self.angle_increment is None else self.angle_increment
        covered = (num_beams - 1) * abs(step)
        if covered > TWO_PI * (1.0 + _OVERLAP):
            raise ValueError(
                f"angle_increment={self.angle_increment}: must be within one revolution (rad), got "
                f"{covered:.3f} rad between the first and last of {num_beams} beams"
            )
        return -step if self.is_upside_down else step

    def bearings(self, num_beams: int) -> Tensor:
        """Return the direction of each beam, ``[num_beams]`` float64 rad, scanner's frame."""
        first = -self.angle_min if self.is_upside_down else self.angle_min
        return first + torch.arange(num_beams, dtype=torch.float64) * self.increment(num_beams)

    def states(self, ranges: Tensor) -> Tensor:
        """Classify readings ``[*B, beams]`` m to codes of :class:`BeamState` ``[*B, beams]``."""
        states = torch.full(ranges.shape, int(BeamState.RETURN), device=ranges.device)
        beyond = ranges > self.range_max + _BEYOND_M
        rules: list[tuple[Tensor, Reading]] = [
            (ranges >= self.range_max, "no_return"),
            ((ranges < 0.0) | beyond, "invalid"),
            ((ranges > 0.0) & (ranges < self.range_min), self.below_range_min),
            (ranges == 0.0, self.zero),
            (ranges.isposinf(), self.positive_infinity),
            (ranges.isneginf(), self.negative_infinity),
            (ranges.isnan(), self.nan),
        ]
        for mask, reading in rules:  # later rules are the more specific ones
            states = torch.where(mask, int(_STATES[reading]), states)
        if self.blind_sectors:
            bearing = self.bearings(ranges.shape[-1]).to(ranges.device)
            for center, width in self.blind_sectors:
                offset = (bearing - center + math.pi).remainder(TWO_PI) - math.pi
                is_blind = offset.abs() <= 0.5 * width + 1e-9
                states = torch.where(is_blind, int(BeamState.NOT_SEEN), states)
        return states
