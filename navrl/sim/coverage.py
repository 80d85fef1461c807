"""Field of view of a lidar, and sectors that the robot's own parts cover."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from navrl.sim.draws import Value, draw, limits

FULL_CIRCLE = 2.0 * math.pi
_ROUNDING = 1e-9  # rad; a beam on the border of the field of view or of a sector measures


class Coverage:
    """Beams that measure, fixed or drawn once per episode; the others are blind.

    Angles are those of the beams, in the frame of the lidar's mount.

    Args:
        angles: [beams] float64 rad, direction of each beam.
        field_of_view: Width of the field of view, centered on the mount's x axis, rad; beams
            outside are blind. A distribution may exceed the full circle, which then is drawn more
            often.
        blind_sectors: (bearing, width) of each sector that is blind within the field of view, rad.

    Raises:
        ValueError: If a value is out of range.

    Example:
        >>> angles = torch.arange(8, dtype=torch.float64) * math.pi / 4
        >>> Coverage(angles, math.pi, [(0.0, 0.1)]).measured(torch.tensor([7])).int()
        tensor([[0, 1, 1, 0, 0, 0, 1, 1]], dtype=torch.int32)
    """

    def __init__(
        self,
        angles: Tensor,
        field_of_view: Value = FULL_CIRCLE,
        blind_sectors: Sequence[Sequence[Value]] = (),
    ) -> None:
        """Check and store the arguments."""
        low, high = limits(field_of_view)
        widest = FULL_CIRCLE + _ROUNDING if low == high else 2.0 * FULL_CIRCLE
        if not 0.0 < low <= high <= widest:
            raise ValueError(
                f"field_of_view={field_of_view}: must be in (0, 2 pi] rad, a distribution in "
                "(0, 4 pi]"
            )
        for index, sector in enumerate(blind_sectors):
            _check_sector(f"blind_sectors[{index}]", sector)
        self.field_of_view = field_of_view
        self.blind_sectors = [(bearing, width) for bearing, width in blind_sectors]
        self._angles = angles
        self._from_axis = _wrapped(angles).abs()

    @property
    def is_full(self) -> bool:
        """Return whether all beams measure in all episodes."""
        return limits(self.field_of_view)[0] >= FULL_CIRCLE - _ROUNDING and not self.blind_sectors

    @property
    def is_fixed(self) -> bool:
        """Return whether the same beams measure in all episodes."""
        values = [self.field_of_view, *(value for sector in self.blind_sectors for value in sector)]
        return _is_fixed(*values)

    def measured(self, seed: Tensor) -> Tensor:
        """Return the beams that measure in each episode.

        Args:
            seed: [M] int64, ``noise_seed`` of the scenarios.

        Returns:
            [M, beams] bool.
        """
        if self._angles.device != seed.device:
            self._angles = self._angles.to(seed.device)
            self._from_axis = self._from_axis.to(seed.device)
        rows = seed[:1] if self.is_fixed else seed
        half = 0.5 * draw("lidar.field_of_view", self.field_of_view, rows)
        measured = self._from_axis <= half.unsqueeze(-1) + _ROUNDING
        for index, (bearing, width) in enumerate(self.blind_sectors):
            center = draw(f"lidar.blind_sectors.{index}.bearing", bearing, rows).unsqueeze(-1)
            half = 0.5 * draw(f"lidar.blind_sectors.{index}.width", width, rows).unsqueeze(-1)
            measured &= _wrapped(self._angles - center).abs() >= half - _ROUNDING
        return measured.expand(len(seed), -1)

    def in_smallest_view(self) -> Tensor:
        """Return [beams] bool, inside of the field of view in all episodes."""
        return self._from_axis.cpu() <= 0.5 * limits(self.field_of_view)[0] + _ROUNDING

    def in_all_episodes(self) -> Tensor:
        """Return [beams] bool, inside of the smallest field of view and of no fixed sector."""
        smallest = limits(self.field_of_view)[0]
        fixed = [sector for sector in self.blind_sectors if _is_fixed(*sector)]
        seed = torch.zeros(1, dtype=torch.int64)
        return Coverage(self._angles.cpu(), smallest, fixed).measured(seed)[0]


def _check_sector(name: str, sector: Sequence[Value]) -> None:
    if len(sector) != 2:
        raise ValueError(f"{name}={list(sector)}: must be (bearing, width) in rad")
    bearings, widths = map(limits, sector)
    if not all(math.isfinite(bearing) for bearing in bearings):
        raise ValueError(f"{name}: bearing={sector[0]}: must be finite (rad)")
    if not 0.0 <= widths[0] <= widths[1] <= FULL_CIRCLE:
        raise ValueError(f"{name}: width={sector[1]}: must be in [0, 2 pi] rad")


def _is_fixed(*values: Value) -> bool:
    return all(low == high for low, high in map(limits, values))


def _wrapped(angle: Tensor) -> Tensor:
    """Return angles wrapped to [-pi, pi), rad."""
    return (angle + math.pi).remainder(FULL_CIRCLE) - math.pi
