"""Lidar model: beam directions, range limit, mount and noise."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from navrl.checks import check_positive, checked_pose
from navrl.ops import se2
from navrl.ops.noise import add_range_noise, noise_table
from navrl.ops.raycast import Beams, beam_angles
from navrl.ops.scan_layout import ScanLayout
from navrl.sim.beam_errors import BeamErrors
from navrl.sim.coverage import FULL_CIRCLE, Coverage
from navrl.sim.draws import Value, check_not_negative, draw, limits


class Lidar:
    """Planar lidar; beam j points at ``angle_min + j angle_increment`` in the mount's frame.

    :meth:`beam_angles` is the source for ray casting, pooling, pictures and the runner. Nothing
    within ``max_range`` reads exactly ``max_range``. A scanner inside of a box reads 0 in every
    beam. The robot itself is never seen.

    Args:
        num_beams: Beams per scan.
        max_range: Range limit, m.
        noise: ``gaussian``, ``uniform`` or ``none``.
        noise_amplitude: Standard deviation of ``gaussian``, half width of ``uniform`` noise at
            range zero, m, fixed or drawn per episode.
        mount: (x, y, yaw) of the scanner in the robot frame, m and rad.
        height: Height of the scan plane over the floor, m; PyBullet casts its rays there.
        angle_min: Angle of beam 0, rad.
        angle_increment: Angle between successive beams, rad, negative if counted clockwise;
            None spreads the beams evenly over a full circle, counter-clockwise.
        field_of_view: Width of the field of view around the mount's x axis, rad, fixed or drawn
            per episode. Beams outside are blind: they read ``max_range``, like no return.
        blind_sectors: (bearing, width) of each blind sector within the field of view, rad, each
            number fixed or drawn per episode: posts and plates of the robot in front of the lidar.
        noise_per_m: Growth of ``noise_amplitude`` with the range, m per m, fixed or per episode.
        dropout: Share of the beams without return, see :class:`navrl.sim.beam_errors.BeamErrors`.
        speckle: Share of the beams with a false, shorter range.
        speckle_min_range: Smallest false range, m.

    Raises:
        ValueError: If a value is out of range.

    Reference:
        Paper Sec. IV-G: RPLidar A3, 1,440 beams, capped at 3.5 m, noise "amplitude of 2.5 cm",
        interpreted as the standard deviation of a beam and added to returns only.
    """

    def __init__(
        self,
        num_beams: int = 1440,
        max_range: float = 3.5,
        noise: str = "gaussian",
        noise_amplitude: Value = 0.025,
        mount: Sequence[float] = (0.0, 0.0, 0.0),
        height: float = 0.5,
        angle_min: float = 0.0,
        angle_increment: float | None = None,
        field_of_view: Value = FULL_CIRCLE,
        blind_sectors: Sequence[Sequence[Value]] = (),
        noise_per_m: Value = 0.0,
        dropout: Value = 0.0,
        speckle: Value = 0.0,
        speckle_min_range: Value = 0.2,
    ) -> None:
        if num_beams < 1:
            raise ValueError(f"num_beams={num_beams}: must be at least 1")
        check_positive(max_range=max_range, height=height)
        x, y, yaw = checked_pose("mount", mount).tolist()
        self.mount = (x, y, yaw)
        ScanLayout(num_beams, None, 1, angle_min, angle_increment, self.mount)  # checks angles
        self.num_beams = int(num_beams)
        self.angle_min = float(angle_min)
        self.angle_increment = None if angle_increment is None else float(angle_increment)
        self.max_range = float(max_range)
        self.height = float(height)
        self.noise, self.noise_amplitude, self.noise_per_m = noise, noise_amplitude, noise_per_m
        check_not_negative(noise_amplitude=noise_amplitude, noise_per_m=noise_per_m)
        self._is_scaled = limits(noise_amplitude)[0] < limits(noise_amplitude)[1]
        self._is_scaled |= limits(noise_per_m)[1] > 0.0
        self._table = noise_table(noise, 1.0 if self._is_scaled else limits(noise_amplitude)[1])
        self.coverage = Coverage(self.beam_angles(), field_of_view, blind_sectors)
        self.errors = BeamErrors(dropout, speckle, speckle_min_range, self.max_range)

    def beam_angles(self) -> Tensor:
        """Return [num_beams] float64 rad, each beam's angle in the mount's frame."""
        return beam_angles(*self.beams)

    @property
    def increment(self) -> float:
        """Angle from one beam to the next, rad."""
        full = 2.0 * math.pi / self.num_beams
        return full if self.angle_increment is None else self.angle_increment

    @property
    def beams(self) -> Beams:
        """Number of beams, ``angle_min`` and ``angle_increment``."""
        return self.num_beams, self.angle_min, self.angle_increment

    def points(self, ranges: Tensor) -> Tensor:
        """Return the end point of each beam in the robot frame.

        Args:
            ranges: [*B, num_beams] m.

        Returns:
            [*B, num_beams, 2] m; a beam without a return ends at ``max_range``.
        """
        angle = self.beam_angles().to(ranges)
        ends = ranges.unsqueeze(-1) * torch.stack((angle.cos(), angle.sin()), dim=-1)
        mount = torch.tensor(self.mount, dtype=ranges.dtype, device=ranges.device)
        return se2.transform_points(mount.expand(*ranges.shape[:-1], 3), ends)

    def nearest(self, ranges: Tensor) -> Tensor:
        """Return the distance from the robot's center to the nearest return.

        Args:
            ranges: [*B, num_beams] m.

        Returns:
            [*B] m, ``max_range`` without a return.
        """
        if self.mount[:2] == (0.0, 0.0):
            return ranges.amin(dim=-1)
        distance = torch.linalg.vector_norm(self.points(ranges), dim=-1)
        return torch.where(ranges < self.max_range, distance, self.max_range).amin(dim=-1)

    def add_noise(self, ranges: Tensor, seed: Tensor, step: Tensor) -> Tensor:
        """Return the ranges as the lidar reports them: with errors, blind beams and noise.

        See :class:`navrl.sim.beam_errors.BeamErrors`, :class:`navrl.sim.coverage.Coverage` and
        :func:`navrl.ops.noise.add_range_noise`.

        Args:
            ranges: [N, num_beams] float32 m, noise-free; not modified.
            seed: [N] int64, ``noise_seed`` of the scenarios.
            step: [N] int64, steps since the reset of each world.

        Returns:
            [N, num_beams] float32 m, a new tensor.
        """
        if not self.errors.is_none:
            ranges = self.errors.apply(ranges, seed, step)
        if not self.coverage.is_full:
            ranges = torch.where(self.coverage.measured(seed), ranges, self.max_range)
        if self.noise == "none" or (not self._is_scaled and limits(self.noise_amplitude)[1] == 0.0):
            return ranges.clone()
        if self._table.device != ranges.device:
            self._table = self._table.to(ranges.device)
        scale = self._noise_scale(ranges, seed) if self._is_scaled else None
        return add_range_noise(ranges, seed, step, self._table, self.max_range, scale=scale)

    def _noise_scale(self, ranges: Tensor, seed: Tensor) -> Tensor:
        """Return [N, beams] m, the amplitude of each beam's noise."""
        amplitude = draw("lidar.noise_amplitude", self.noise_amplitude, seed).float()
        per_m = draw("lidar.noise_per_m", self.noise_per_m, seed).float()
        return amplitude.unsqueeze(-1) + per_m.unsqueeze(-1) * ranges
