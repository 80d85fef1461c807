"""Correction of scans for the robot's motion since their beams were measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec

from navrl import keys
from navrl.checks import check_positive
from navrl.ops import se2
from navrl.ops.projection import bin_bearings, rebin_scan
from navrl.ops.scan_layout import TWO_PI, check_layout
from navrl.ops.unicycle import advance_poses
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec

Source = Literal["motion", "commands"]


class MotionCompensation(ObservationMap):
    """Move a scan that is old, or measured during a revolution, to the robot's present frame.

    Each point moves by the robot's frame at the time of its beam, interpolated linearly between the
    frames of the first and the last beam. On an arc of constant (v, w) the interpolation is off by
    at most ``v w T^2 / 8`` for a revolution of T seconds: 0.6 mm at 0.5 m/s, 1 rad/s and 0.1 s,
    8 mm at 0.5 m/s, pi rad/s and 0.2 s.

    The moved points are ordered by bearing again, one per bin, because the networks, the rotation
    search of ICP and :class:`navrl.transforms.RangeHistory` read the bearing from the index. A ray
    without a return keeps its direction and remains a point at ``max_range``: it still means free.
    A return that is now beyond ``max_range`` becomes such a ray. The pedestrians' own motion since
    the scan is not known and not corrected.

    The step belongs between MinPool, which writes the measured scan, and ScanHistory. Then scan t-1
    is in the robot frame at t-1, scan t in that at t, and ICP estimates the motion between them.

    Args:
        source: ``"motion"`` reads both frames, from odometry. ``"commands"`` integrates a command
            held since the scan, for robots without odometry.
        group_size: That of the :class:`navrl.transforms.MinPool` before.
        max_range: Range of the sensor, m.
        angle_min: Bearing of beam 0 in the scanner's frame, rad.
        angle_increment: Angle from one beam to the next, rad, negative for clockwise order; None
            for beams over a full circle, counter-clockwise.
        num_beams: Beams of the scan, for less than a full circle; None for a full circle.
        mount: (x, y, yaw) of the scanner in the robot frame, m and rad; only the yaw is used.
        age_s: Age of the last beam, s; only for ``"commands"``.
        revolution_s: Time from the first to the last beam, s; only for ``"commands"``.
        in_keys: Three keys. Points ``[*B, N, 2]`` m and returns ``[*B, N]`` bool as measured,
            ordered by bearing. Then for ``"motion"`` the poses (m, m, rad) of the robot at the
            first and last beam in its present frame ``[*B, 2, 3]``, for ``"commands"`` the command
            (v, w), m/s and rad/s, ``[*B, 2]``. Optionally a fourth: the bins covered by the lidar
            ``[*B, N]`` bool.
        out_keys: Points ``[*B, N, 2]`` m and returns ``[*B, N]`` bool in the present frame;
            optionally the ranges ``[*B, N]`` m, and then the covered bins ``[*B, N]`` bool.

    Raises:
        ValueError: If an argument is invalid, or later if the motion has another shape.

    Example:
        >>> points = torch.tensor([[[2.0, 0.0], [0.0, 1.0], [-2.0, 0.0], [0.0, -1.0]]])
        >>> drove = torch.tensor([[[-0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]]])  # 0.1 m ahead since
        >>> moved, _ = MotionCompensation(group_size=1, out_keys=["points", "returns"])(
        ...     points_measured=points, returns_measured=torch.ones(1, 4, dtype=torch.bool),
        ...     scan_motion=drove,
        ... )
        >>> moved[0, 0]
        tensor([1.9000, 0.0000])

    Reference:
        Not in the paper, whose scans have no age. Rates and ages of real scanners are in
        docs/scans.md.
    """

    INPUTS = ("measured points", "measured returns", "motion")
    OPTIONAL_INPUTS = ("seen",)
    OUTPUTS = ("points", "returns")
    OPTIONAL_OUTPUTS = ("ranges", "seen")

    def __init__(
        self,
        source: Source = "motion",
        group_size: int | None = 8,
        max_range: float = 3.5,
        angle_min: float = 0.0,
        angle_increment: float | None = None,
        num_beams: int | None = None,
        mount: Sequence[float] = (0.0, 0.0, 0.0),
        age_s: float = 0.0,
        revolution_s: float = 0.0,
        in_keys: Keys | None = None,
        out_keys: Keys = (keys.POINTS, keys.RETURNS, keys.RANGES_POOLED),
    ) -> None:
        """Check and store the arguments."""
        if source not in ("motion", "commands"):
            raise ValueError(f"source={source!r}: must be one of motion, commands")
        if in_keys is None:
            motion = keys.SCAN_MOTION if source == "motion" else keys.COMMAND
            in_keys = (keys.POINTS_MEASURED, keys.RETURNS_MEASURED, motion)
        super().__init__(in_keys, out_keys)
        check_positive(max_range=max_range)
        check_layout(group_size, 1, angle_min, angle_increment, mount)
        if num_beams is not None and num_beams < 2:
            raise ValueError(f"num_beams={num_beams}: must be at least 2, or None")
        for name, value in (("age_s", age_s), ("revolution_s", revolution_s)):
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name}={value}: must be finite and at least 0 (s)")
            if value and source == "motion":
                raise ValueError(
                    f"{name}={value}: must be 0 for source='motion', which has the age"
                )
        self.source: Source = source
        self.group_size, self.max_range = group_size, max_range
        self.angle_min, self.angle_increment = angle_min, angle_increment
        self.num_beams, self.mount = num_beams, tuple(float(value) for value in mount)
        self.age_s, self.revolution_s = age_s, revolution_s

    def map_values(
        self, points: Tensor, returns: Tensor, motion: Tensor, seen: Tensor | None = None
    ) -> Sequence[Tensor]:
        """Move each point by the frame of its beam and order the result by bearing."""
        first, last = self.frames(motion)
        fraction = self.sweep(points.shape[-2]).to(points.device)
        frame = se2.interpolate(first, last, fraction).to(points.dtype)
        moved = se2.rotate(points, frame[..., 2]) + frame[..., :2]
        scan = rebin_scan(moved, returns, self.group_size, self.max_range, seen)
        outputs = (scan.points, scan.returns, scan.ranges, scan.seen)
        return outputs[: len(self.out_keys)]

    def frames(self, motion: Tensor) -> tuple[Tensor, Tensor]:
        """Return the robot's frames at the first and last beam, each ``[*B, 3]`` float64.

        Raises:
            ValueError: If the third input has another shape than its source requires.
        """
        motion = motion.double()
        if self.source == "motion":
            self._check_shape(motion.shape[-2:], (2, 3))
            return motion[..., 0, :], motion[..., 1, :]
        self._check_shape(motion.shape[-1:], (2,))
        start = torch.zeros(*motion.shape[:-1], 3, dtype=motion.dtype, device=motion.device)
        first, last = (
            se2.inverse(advance_poses(start, motion, age))
            for age in (self.age_s + self.revolution_s, self.age_s)
        )
        return first, last

    def sweep(self, num_points: int) -> Tensor:
        """Return when each bin is measured, ``[N]`` float64 from 0, first, to 1, last beam.

        A bin in which the revolution begins has beams of both ends; it counts as its center.
        """
        bearing = bin_bearings(num_points, self.group_size, torch.float64)
        sign = -1.0 if (self.angle_increment or 1.0) < 0.0 else 1.0
        offset = (sign * (bearing - self.angle_min - self.mount[2])).remainder(TWO_PI)
        if self.num_beams is None or self.angle_increment is None:
            return offset / TWO_PI
        span = (self.num_beams - 1) * abs(self.angle_increment)
        # a bin around the first beam may have its center before it
        offset = torch.where(offset > 0.5 * (span + TWO_PI), 0.0, offset)
        return (offset / span).clamp(max=1.0)

    def map_specs(
        self,
        points: TensorSpec,
        returns: TensorSpec,
        motion: TensorSpec,
        seen: TensorSpec | None = None,
    ) -> Sequence[TensorSpec]:
        """Return the specs of points, returns and, if requested, ranges and seen.

        Raises:
            ValueError: If the third input has another shape than its source requires.
        """
        size = 2 if self.source == "motion" else 1
        self._check_shape(motion.shape[-size:], (2, 3)[:size])
        kind = {"dtype": torch.float32, "device": points.device}
        bins = points.shape[:-1]
        specs = (
            Bounded(-self.max_range, self.max_range, points.shape, **kind),
            flag_spec(points, *bins),
            Bounded(0.0, self.max_range, bins, **kind),
            flag_spec(points, *bins),
        )
        return specs[: len(self.out_keys)]

    def _check_shape(self, shape: torch.Size, needed: tuple[int, ...]) -> None:
        if tuple(shape) != needed:
            form = ", ".join(map(str, needed))
            raise ValueError(
                f"{self.in_keys[2]}: must have shape [*B, {form}] for source={self.source!r}, "
                f"got [*B, {', '.join(map(str, shape))}]"
            )
