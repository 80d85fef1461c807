"""Checks of the scenarios with which worlds are reset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from navrl.worlds import ScenarioBatch


FARTHEST_M = 10_000.0  # m from the origin; a float32 pose is accurate to 1 mm there


def check_reset(
    worlds: Tensor, scenarios: ScenarioBatch, num_worlds: int, max_pedestrians: int
) -> None:
    """Raise the ``ValueError`` of :meth:`navrl.sim.Simulator.reset`."""
    if worlds.ndim != 1 or worlds.dtype != torch.int64:
        raise ValueError(f"worlds: must be [M] int64, got {list(worlds.shape)} {worlds.dtype}")
    if len(worlds) != len(scenarios):
        raise ValueError(
            f"scenarios: must be {len(worlds)}, one for each of worlds, got {len(scenarios)}"
        )
    if len(worlds) == 0:
        return
    inside = worlds.clamp(0, num_worlds - 1)
    times = worlds.new_zeros(num_worlds).index_add_(0, inside, torch.ones_like(worlds))
    max_present = scenarios.ped_present.sum(-1).amax()
    bad_walls = _invalid_boxes(scenarios.boxes, scenarios.num_boxes)
    verdicts = [
        (inside != worlds).any(),
        times.amax() > 1,
        max_present > max_pedestrians,
        ~(scenarios.start.abs() <= FARTHEST_M).all(),  # NaN too
        bad_walls.any(),
    ]
    # Transferred together, because each transfer synchronizes with the host.
    outside, repeated, crowded, far, impossible = torch.stack(verdicts).tolist()
    if outside:
        raise ValueError(f"worlds: must be within 0..{num_worlds - 1}")
    if repeated:
        raise ValueError("worlds: must be distinct")
    if crowded:
        raise ValueError(
            f"max_pedestrians={max_pedestrians}: must be at least {int(max_present)}, the "
            "pedestrians of a scenario"
        )
    if far:
        raise ValueError(
            f"scenarios.start: must be finite and within {FARTHEST_M:.0f} m of the origin, "
            "because poses are float32; shift the scenario"
        )
    if impossible:
        row, wall = bad_walls.nonzero()[0].tolist()
        raise ValueError(
            f"wall {wall} of scenario {row}: must be finite with half sizes >= 0, "
            f"got {scenarios.boxes[row, wall].tolist()}"
        )


def _invalid_boxes(boxes: Tensor, num_boxes: Tensor) -> Tensor:
    """Return [M, W] bool, which of the first ``num_boxes`` [M] boxes [M, W, 5] are invalid."""
    is_wall = torch.arange(boxes.shape[1], device=boxes.device) < num_boxes[:, None]
    return is_wall & ~(torch.isfinite(boxes).all(-1) & (boxes[..., 2:4] >= 0.0).all(-1))
