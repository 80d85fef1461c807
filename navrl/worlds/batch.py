"""Batches of scenarios as tensors, the input of simulators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from navrl.worlds.scenario import MAX_PATH_POINTS, MAX_ROUTE_POINTS, Scenario

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
        boxes: ``[S, W, 5]`` float64 walls; rows from ``num_boxes`` on are padding.
        num_boxes: ``[S]`` int64.
        num_furniture: ``[S]`` int64, number of furniture boxes, which are the last ones.
        start: ``[S, 3]`` float64 robot pose.
        goal: ``[S, 2]`` float64 m.
        path: ``[S, MAX_PATH_POINTS, 2]`` float32 m, padded by repeating the goal.
        path_length: ``[S]`` float64 m.
        route: ``[S, K, MAX_ROUTE_POINTS, 2]`` float64 m, padded by repeating the last point.
        route_arc: ``[S, K, MAX_ROUTE_POINTS]`` float64 m, arc length of each route point.
        ped_speed: ``[S, K]`` float64 m/s.
        ped_offset: ``[S, K]`` float64 m.
        ped_half: ``[S, K, 2]`` float64 m.
        ped_present: ``[S, K]`` bool.
        ped_static: ``[S, K]`` bool.
        kind: ``[S]`` int64, index into ``kinds``.
        noise_seed: ``[S]`` int64.
        kinds: Names of the kinds of worlds; empty if they are not known.
    """

    boxes: Tensor
    num_boxes: Tensor
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
        boxes = max(len(s.boxes) for s in scenarios)
        people = max(len(s.pedestrians) for s in scenarios)
        for name, limit, found in (
            ("max_boxes", max_boxes, boxes),
            ("max_pedestrians", max_pedestrians, people),
        ):
            if limit is not None and found > limit:
                raise ValueError(f"{name}={limit}: must be >= {found}, as in one of the scenarios")
        width = max_boxes or max(boxes, 1), max_pedestrians or max(people, 1)
        kinds = tuple(sorted({scenario.kind for scenario in scenarios}))
        rows = [_row(scenario, *width, kinds.index(scenario.kind)) for scenario in scenarios]
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
        """Rebuild from :meth:`tensors`; older data without furniture is accepted."""
        tensors = {"num_furniture": torch.zeros_like(tensors["num_boxes"]), **tensors}
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

    def with_noise_seed(self, noise_seed: Tensor) -> ScenarioBatch:
        """Replace the seeds ``[S]`` of the lidar's noise."""
        return replace(self, noise_seed=noise_seed)


def tensor_names() -> list[str]:
    """Return the names of the tensors of a batch."""
    return [field.name for field in fields(ScenarioBatch) if field.name != "kinds"]


def _row(
    scenario: Scenario, max_boxes: int, max_pedestrians: int, kind: int
) -> dict[str, ArrayLike]:
    people = scenario.pedestrians
    boxes = np.zeros((max_boxes, 5))
    boxes[: len(scenario.boxes)] = scenario.boxes
    path = np.repeat(scenario.path[-1:], MAX_PATH_POINTS, axis=0)
    path[: len(scenario.path)] = scenario.path
    route = np.zeros((max_pedestrians, MAX_ROUTE_POINTS, 2))
    arc = np.zeros((max_pedestrians, MAX_ROUTE_POINTS))
    for k, person in enumerate(people):
        route[k] = person.route[-1]
        route[k, : len(person.route)] = person.route
        arc[k, 1:] = np.linalg.norm(np.diff(route[k], axis=0), axis=1).cumsum()
    pad = max_pedestrians - len(people)
    half = [person.half_size for person in people] + [(0.0, 0.0)] * pad
    return {
        "boxes": boxes,
        "num_boxes": np.int64(len(scenario.boxes)),
        "num_furniture": np.int64(scenario.num_furniture),
        "start": scenario.start,
        "goal": scenario.goal,
        "path": path.astype(np.float32),
        "path_length": np.linalg.norm(np.diff(scenario.path, axis=0), axis=1).sum(),
        "route": route,
        "route_arc": arc,
        "ped_speed": np.array([p.speed for p in people] + [0.0] * pad),
        "ped_offset": np.array([p.offset for p in people] + [0.0] * pad),
        "ped_half": np.array(half, dtype=np.float64).reshape(-1, 2),
        "ped_present": np.arange(max_pedestrians) < len(people),
        "ped_static": np.array([p.is_static for p in people] + [False] * pad),
        "kind": np.int64(kind),
        "noise_seed": np.int64(scenario.noise_seed),
    }


def pedestrian_boxes(batch: ScenarioBatch, time_s: Tensor) -> Tensor:
    """Return the pedestrians' boxes at given times.

    The position along the route is a triangle wave of time: back and forth at constant speed. The
    yaw is the direction of travel; stationary pedestrians have yaw 0.

    Args:
        batch: S scenarios.
        time_s: ``[S]`` s since the start.

    Returns:
        ``[S, K, 5]`` float64 (cx, cy, hx, hy, yaw), world; NaN rows for absent pedestrians.
    """
    length = batch.route_arc[..., -1]
    traveled = batch.ped_offset + batch.ped_speed * time_s.double().unsqueeze(-1)
    phase = torch.remainder(traveled, (2 * length).clamp_min(1e-9))
    returning = phase > length
    arc = torch.where(returning, 2 * length - phase, phase).clamp_min(0.0)
    ends = batch.route_arc[..., 1:].contiguous()
    segment = torch.searchsorted(ends, arc.unsqueeze(-1)).clamp_max(MAX_ROUTE_POINTS - 2)
    pair = segment.unsqueeze(-1).expand(*segment.shape, 2)
    first = batch.route.gather(-2, pair).squeeze(-2)
    second = batch.route.gather(-2, pair + 1).squeeze(-2)
    begin = batch.route_arc.gather(-1, segment).squeeze(-1)
    step = second - first
    size = step.norm(dim=-1)
    share = ((arc - begin) / size.clamp_min(1e-9)).clamp(0.0, 1.0)
    position = first + share.unsqueeze(-1) * step
    sign = torch.where(returning, -1.0, 1.0).double()
    yaw = torch.atan2(sign * step[..., 1], sign * step[..., 0])
    yaw = torch.where(batch.ped_static | (size == 0), 0.0, yaw)
    boxes = torch.cat([position, batch.ped_half, yaw.unsqueeze(-1)], dim=-1)
    return boxes.masked_fill(~batch.ped_present.unsqueeze(-1), torch.nan)
