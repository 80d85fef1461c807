"""Errors of single beams: dropouts and false short ranges."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.ops.noise import beam_uniform
from navrl.sim.draws import Value, draw, limits

_KIND, _RANGE = 101, 102  # streams of the generator


class BeamErrors:
    """Dropouts and speckle of a scan, drawn per beam and step.

    Args:
        dropout: Share of the beams that report no return, fixed or drawn per episode.
        speckle: Share of the beams that report a false range, as from dust or rain in the air,
            uniform between ``speckle_min_range`` and the true one.
        speckle_min_range: Smallest false range, m.
        max_range: Range of the sensor, m.

    Raises:
        ValueError: If a share is not in [0, 1], their sum exceeds 1, or, with
            speckle, ``speckle_min_range`` is not in [0, max_range).
    """

    def __init__(
        self, dropout: Value, speckle: Value, speckle_min_range: Value, max_range: float
    ) -> None:
        """Check and store the arguments."""
        for name, share in (("dropout", dropout), ("speckle", speckle)):
            low, high = limits(share)
            if not 0.0 <= low <= high <= 1.0:
                raise ValueError(f"{name}={share}: must be in [0, 1], a share of the beams")
        if limits(dropout)[1] + limits(speckle)[1] > 1.0:
            raise ValueError(f"dropout={dropout}, speckle={speckle}: their sum must be at most 1")
        low, high = limits(speckle_min_range)
        if limits(speckle)[1] > 0.0 and not 0.0 <= low <= high < max_range:
            raise ValueError(
                f"speckle_min_range={speckle_min_range}: must be in [0, max_range={max_range}) m"
            )
        self.dropout, self.speckle = dropout, speckle
        self.speckle_min_range, self.max_range = speckle_min_range, max_range

    @property
    def is_none(self) -> bool:
        """Return whether no beam has an error in any episode."""
        return limits(self.dropout)[1] == limits(self.speckle)[1] == 0.0

    def apply(self, ranges: Tensor, seed: Tensor, step: Tensor) -> Tensor:
        """Return the ranges with errors.

        Args:
            ranges: [N, beams] float32 m, not modified.
            seed: [N] int64, ``noise_seed`` of the scenarios.
            step: [N] int64, number of scans since the start of the episode.

        Returns:
            [N, beams] float32 m, a new tensor; ``max_range`` where a beam dropped out.
        """
        kind = beam_uniform(seed, _KIND, step, ranges.shape[1])
        dropout = draw("lidar.dropout", self.dropout, seed).unsqueeze(-1)
        with_speckle = dropout + draw("lidar.speckle", self.speckle, seed).unsqueeze(-1)
        if limits(self.speckle)[1] > 0.0:
            low = draw("lidar.speckle_min_range", self.speckle_min_range, seed).unsqueeze(-1)
            low = low.float().minimum(ranges)
            place = beam_uniform(seed, _RANGE, step, ranges.shape[1])
            ranges = torch.where(kind < with_speckle.float(), low + place * (ranges - low), ranges)
        return torch.where(kind < dropout.float(), self.max_range, ranges)
