"""Rows of a batch of scenarios."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from navrl.ops.bodies import BODIES
from navrl.worlds.scenario import MAX_PATH_POINTS, Scenario


def scenario_row(
    scenario: Scenario, max_boxes: int, max_pedestrians: int, max_points: int, kind: int
) -> dict[str, ArrayLike]:
    """Return the row of a scenario in a :class:`navrl.worlds.ScenarioBatch`, by tensor name."""
    path = np.repeat(scenario.path[-1:], MAX_PATH_POINTS, axis=0)
    path[: len(scenario.path)] = scenario.path
    return {
        **_obstacles(scenario, max_boxes),
        "start": scenario.start,
        "goal": scenario.goal,
        "path": path.astype(np.float32),
        "path_length": np.linalg.norm(np.diff(scenario.path, axis=0), axis=1).sum(),
        **_people(scenario, max_pedestrians, max_points),
        "kind": np.int64(kind),
        "noise_seed": np.int64(scenario.noise_seed),
    }


def _obstacles(scenario: Scenario, max_boxes: int) -> dict[str, ArrayLike]:
    boxes, heights = np.zeros((max_boxes, 5)), np.zeros((max_boxes, 2))
    heights[:, 1] = np.inf
    found = scenario.obstacles
    boxes[: len(found)] = found
    if len(scenario.heights):
        heights[: len(found)] = scenario.heights
    index = np.arange(max_boxes)
    return {
        "boxes": boxes,
        "num_boxes": np.int64(len(found)),
        "num_furniture": np.int64(scenario.num_furniture),
        "box_is_disc": (index >= len(scenario.boxes)) & (index < len(found)),
        "box_heights": heights,
    }


def _people(scenario: Scenario, max_pedestrians: int, max_points: int) -> dict[str, ArrayLike]:
    people = scenario.pedestrians
    route = np.zeros((max_pedestrians, max_points, 2))
    arc = np.zeros((max_pedestrians, max_points))
    for k, person in enumerate(people):
        count = len(person.route)
        route[k] = person.route[-1]
        route[k, :count] = person.route
        if person.times is None:
            arc[k, 1:] = np.linalg.norm(np.diff(route[k], axis=0), axis=1).cumsum()
        else:
            arc[k] = person.times[-1]
            arc[k, :count] = person.times
    pad = max_pedestrians - len(people)
    half = [person.half_size for person in people] + [(0.0, 0.0)] * pad
    return {
        "route": route,
        "route_arc": arc,
        "ped_speed": np.array([p.speed for p in people] + [0.0] * pad),
        "ped_offset": np.array([p.offset for p in people] + [0.0] * pad),
        "ped_half": np.array(half, dtype=np.float64).reshape(-1, 2),
        "ped_present": np.arange(max_pedestrians) < len(people),
        "ped_static": np.array([p.is_static for p in people] + [False] * pad),
        "ped_tracked": np.array([p.times is not None for p in people] + [False] * pad),
        "ped_body": np.array([BODIES.index(p.body) for p in people] + [0] * pad, dtype=np.int64),
        "ped_leg_radius": np.array([p.leg_radius for p in people] + [0.0] * pad),
    }


def default_tensors(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the tensors that data of older versions lacks: no discs, no tracks."""
    boxes, present = tensors["boxes"], tensors["ped_present"]
    heights = boxes.new_zeros(*boxes.shape[:-1], 2)
    heights[..., 1] = torch.inf
    return {
        "num_furniture": torch.zeros_like(tensors["num_boxes"]),
        "box_is_disc": boxes.new_zeros(boxes.shape[:-1], dtype=torch.bool),
        "box_heights": heights,
        "ped_tracked": torch.zeros_like(present),
        "ped_body": torch.zeros_like(present, dtype=torch.int64),
        "ped_leg_radius": torch.zeros_like(tensors["ped_speed"]),
    }
