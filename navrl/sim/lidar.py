"""Lidar model: beam directions, range limit, mount and noise."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from navrl.ops import se2
from navrl.ops.noise import add_range_noise, noise_table


class Lidar:
    """Planar scanner with ``num_beams`` over the full circle, beam j at 2 pi j / num_beams.

    Beam 0 points along the x axis of the mount and angles increase counter-clockwise. A beam
    without an obstacle within ``max_range`` reads exactly ``max_range``. A scanner inside a box
    reads 0 in every beam. The robot itself is invisible.

    Args:
        num_beams: Beams per scan.
        max_range: Range limit, m.
        noise: ``gaussian``, ``uniform`` or ``none``.
        noise_amplitude: Standard deviation of ``gaussian``, half width of ``uniform`` noise, m.
        mount: (x, y, yaw) of the scanner in the robot frame, m and rad.
        height: Height of the scan plane above the floor, m, for the rays of PyBullet.

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
        noise_amplitude: float = 0.025,
        mount: Sequence[float] = (0.0, 0.0, 0.0),
        height: float = 0.5,
    ) -> None:
        if num_beams < 1:
            raise ValueError(f"num_beams={num_beams}: must be at least 1")
        for name, value in (("max_range", max_range), ("height", height)):
            if not (value > 0.0 and math.isfinite(value)):
                raise ValueError(f"{name}={value}: must be positive and finite (m)")
        if len(mount) != 3 or not all(math.isfinite(value) for value in mount):
            raise ValueError(f"mount={list(mount)}: must be three finite numbers (x, y, yaw)")
        self.num_beams = int(num_beams)
        self.max_range = float(max_range)
        self.noise = noise
        self.noise_amplitude = float(noise_amplitude)
        self.mount = tuple(float(value) for value in mount)
        self.height = float(height)
        self._table = noise_table(noise, noise_amplitude)

    def beam_angles(self) -> Tensor:
        """Return the angle of each beam in the frame of the mount, [num_beams] float64 rad."""
        return torch.arange(self.num_beams, dtype=torch.float64) * (2.0 * math.pi / self.num_beams)

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
        """Return ``ranges`` with noise added to returns.

        See :func:`navrl.ops.noise.add_range_noise`.

        Args:
            ranges: [N, num_beams] float32 m, noise-free; not modified.
            seed: [N] int64, ``noise_seed`` of the scenarios.
            step: [N] int64, steps since the reset of each world.

        Returns:
            [N, num_beams] float32 m, a new tensor.
        """
        if self.noise == "none" or self.noise_amplitude == 0.0:
            return ranges.clone()
        if self._table.device != ranges.device:
            self._table = self._table.to(ranges.device)
        return add_range_noise(ranges, seed, step, self._table, self.max_range)
