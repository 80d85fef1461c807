"""Batches of scenarios as tensors, the input of simulators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor

from navrl.worlds.packing import default_tensors, scenario_row
from navrl.worlds.scenario import MAX_ROUTE_POINTS, Scenario

KINDS = (
    *("corridor", "intersection", "office", "other"),
    *("frontal_approach", "overtaking", "crossing", "blind_corner", "narrow_doorway"),
    *("narrow_hallway", "obstructed_doorway", "circular_crossing"),
)
"""Deprecated: the kinds of worlds of version 0.1; a batch lists its own in ``kinds``."""


@dataclass(frozen=True)
class ScenarioBatch:
    """S scenarios, padded to the same number of walls W and pedestrians K.

    Args:
        boxes: ``[S, W, 5]`` float64 obstacles, boxes and then the bounding squares of discs; rows
            from ``num_boxes`` on are padding.
        num_boxes: ``[S]`` int64.
        box_is_disc: ``[S, W]`` bool, the obstacle is a disc of radius hx.
        box_heights: ``[S, W, 2]`` float64 m, bottom and top; (0, infinity) by default.
        num_furniture: ``[S]`` int64, number of furniture boxes, which are the last ones.
        start: ``[S, 3]`` float64 robot pose.
        goal: ``[S, 2]`` float64 m.
        path: ``[S, MAX_PATH_POINTS, 2]`` float32 m, padded by repeating the goal.
        path_length: ``[S]`` float64 m.
        route: ``[S, K, R, 2]`` float64 m, padded by repeating the last point; R is
            ``MAX_ROUTE_POINTS``, or more with longer tracks.
        route_arc: ``[S, K, R]`` float64 m, arc length of each route point; of a track the time, s.
        ped_speed: ``[S, K]`` float64 m/s; of a track the largest speed.
        ped_offset: ``[S, K]`` float64 m.
        ped_half: ``[S, K, 2]`` float64 m.
        ped_present: ``[S, K]`` bool.
        ped_static: ``[S, K]`` bool.
        ped_tracked: ``[S, K]`` bool, the route is a track.
        ped_body: ``[S, K]`` int64 codes of :mod:`navrl.ops.bodies`.
        ped_leg_radius: ``[S, K]`` float64 m.
        kind: ``[S]`` int64, index into ``kinds``.
        noise_seed: ``[S]`` int64.
        kinds: Names of the kinds of worlds; empty if they are not known.
    """

    boxes: Tensor
    num_boxes: Tensor
    box_is_disc: Tensor
    box_heights: Tensor
    num_furniture: Tensor
    start: Tensor
    goal: Tensor
    path: Tensor
    path_length: Tensor
    route: Tensor
    route_arc: Tensor
    ped_speed: Tensor
    ped_offset: Tensor
    ped_half: Tensor
    ped_present: Tensor
    ped_static: Tensor
    ped_tracked: Tensor
    ped_body: Tensor
    ped_leg_radius: Tensor
    kind: Tensor
    noise_seed: Tensor
    kinds: tuple[str, ...] = ()

    @classmethod
    def pack(
        cls,
        scenarios: Sequence[Scenario],
        max_boxes: int | None = None,
        max_pedestrians: int | None = None,
    ) -> ScenarioBatch:
        """Stack scenarios into a batch.

        Args:
            scenarios: At least one.
            max_boxes: W; if ``None``, the largest number of the scenarios.
            max_pedestrians: K; if ``None``, the largest number of the scenarios, at least 1.

        Raises:
            ValueError: If there is no scenario, or one does not fit.
        """
        if not scenarios:
            raise ValueError("scenarios=[]: must have at least one")
        boxes = max(len(s.boxes) + len(s.discs) for s in scenarios)
        people = max(len(s.pedestrians) for s in scenarios)
        for name, limit, found in (
            ("max_boxes", max_boxes, boxes),
            ("max_pedestrians", max_pedestrians, people),
        ):
            if limit is not None and found > limit:
                raise ValueError(f"{name}={limit}: must be >= {found}, as in one of the scenarios")
        width = max_boxes or max(boxes, 1), max_pedestrians or max(people, 1)
        kinds = tuple(sorted({scenario.kind for scenario in scenarios}))
        points = max((len(p.route) for s in scenarios for p in s.pedestrians), default=0)
        width = *width, max(points, MAX_ROUTE_POINTS)
        rows = [
            scenario_row(scenario, *width, kinds.index(scenario.kind)) for scenario in scenarios
        ]
        stacked = {k: torch.from_numpy(np.stack([row[k] for row in rows])) for k in rows[0]}
        return cls(**stacked, kinds=kinds)

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: Tensor) -> ScenarioBatch:
        return replace(self, **{name: value[rows] for name, value in self.tensors().items()})

    def tensors(self) -> dict[str, Tensor]:
        """Return all tensors by name."""
        return {name: getattr(self, name) for name in tensor_names()}

    @classmethod
    def from_tensors(
        cls, tensors: Mapping[str, Tensor], kinds: Sequence[str] = ()
    ) -> ScenarioBatch:
        """Rebuild from :meth:`tensors`; older data without the newer tensors is accepted."""
        tensors = {**default_tensors(tensors), **tensors}
        return cls(**{name: tensors[name] for name in tensor_names()}, kinds=tuple(kinds))

    def kind_of(self, row: int) -> str:
        """Return the kind of world of a scenario; ``other`` if the names are not known."""
        return self.kinds[int(self.kind[row])] if self.kinds else "other"

    def to(self, device: torch.device | str) -> ScenarioBatch:
        """Move all tensors."""
        return replace(self, **{name: value.to(device) for name, value in self.tensors().items()})

    def with_num_dynamic(self, count: Tensor) -> ScenarioBatch:
        """Return each scenario with its first ``count [S]`` dynamic and all static pedestrians."""
        dynamic = self.ped_present & ~self.ped_static
        kept = dynamic.cumsum(dim=-1) <= count.unsqueeze(-1)
        return replace(self, ped_present=self.ped_present & (self.ped_static | kept))

    def without_pedestrians(self, empty: Tensor) -> ScenarioBatch:
        """Remove all pedestrians from the scenarios where ``empty [S]`` is true."""
        present = self.ped_present & ~empty.unsqueeze(-1)
        return replace(self, ped_present=present)

    def touchable(self, height: float) -> ScenarioBatch:
        """Return the scenarios without the obstacles that a robot passes under.

        Args:
            height: Height of the robot, m.
        """
        bottom, top = self.box_heights.unbind(-1)
        index = torch.arange(self.boxes.shape[1], device=self.boxes.device)
        is_box = index < self.num_boxes[:, None]
        kept = is_box & (bottom < height) & (top > 0.0)
        if bool((kept == is_box).all()):
            return self
        is_furniture = index >= (self.num_boxes - self.num_furniture)[:, None]
        order = torch.argsort(~kept, dim=1, stable=True)
        rows = torch.arange(len(self), device=self.boxes.device)[:, None]
        moved = {
            name: getattr(self, name)[rows, order]
            for name in ("boxes", "box_is_disc", "box_heights")
        }
        count = (kept & is_furniture).sum(-1)
        return replace(self, **moved, num_boxes=kept.sum(-1), num_furniture=count)

    def with_noise_seed(self, noise_seed: Tensor) -> ScenarioBatch:
        """Replace the seeds ``[S]`` of the lidar's noise."""
        return replace(self, noise_seed=noise_seed)


def tensor_names() -> list[str]:
    """Return the names of the tensors of a batch."""
    return [field.name for field in fields(ScenarioBatch) if field.name != "kinds"]
