"""Outlines of obstacles and pedestrians of a recording, as polygons."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from navrl.evaluation.recording import Recording
from navrl.ops.bodies import BODIES, BODY_BOX
from navrl.worlds import Scenario

_NUM_SIDES = 24  # of the polygon of a disc
PASSED_UNDER_M = 0.5  # m; the robot passes under obstacles whose bottom is higher


def wall_outlines(recording: Recording) -> list[np.ndarray]:
    """Return the outline ``[n, 2]`` m of each obstacle, world frame."""
    scenario = _scenario(recording.scenario)
    num_boxes = len(recording.walls) if scenario is None else len(scenario.boxes)
    outlines = [box_corners(box) for box in recording.walls[:num_boxes]]
    return outlines + [_circle(box) for box in recording.walls[num_boxes:]]


def is_passed_under(recording: Recording) -> np.ndarray:
    """Return which obstacles are above the robot, ``[W]`` bool."""
    scenario = _scenario(recording.scenario)
    if scenario is None or not len(scenario.heights):
        return np.zeros(len(recording.walls), dtype=bool)
    return scenario.heights[:, 0] >= PASSED_UNDER_M


def pedestrian_outlines(recording: Recording, step: int) -> list[np.ndarray]:
    """Return the outline ``[n, 2]`` m of each pedestrian's body at a step, world frame."""
    boxes = recording.pedestrian_boxes[step]
    scenario, codes = _scenario(recording.scenario), np.zeros(len(boxes), dtype=int)
    if scenario is not None:
        found = [BODIES.index(person.body) for person in scenario.pedestrians]
        codes[: len(found)] = found[: len(codes)]
    return [
        box_corners(box) if code == BODY_BOX else _circle(box)
        for box, code in zip(boxes, codes, strict=True)
        if np.isfinite(box).all()
    ]


def box_corners(box: np.ndarray) -> np.ndarray:
    """Return the corners ``[4, 2]`` m of a box (cx, cy, hx, hy, yaw)."""
    cx, cy, hx, hy, yaw = box
    cos, sin = np.cos(yaw), np.sin(yaw)
    corners = np.array([[hx, hy], [-hx, hy], [-hx, -hy], [hx, -hy]])
    return corners @ np.array([[cos, sin], [-sin, cos]]) + np.array([cx, cy])


def _circle(box: np.ndarray) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, _NUM_SIDES, endpoint=False)
    return box[:2] + box[2] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


@lru_cache(maxsize=8)
def _scenario(text: str) -> Scenario | None:
    """Return the scenario of a recording; ``None`` if it is not known."""
    try:
        return Scenario.from_json(text)
    except ValueError:
        return None
