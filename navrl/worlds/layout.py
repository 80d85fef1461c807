"""Layout of a world: walls, start, goal and extent; and the interface of world generators."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

WALL_THICKNESS = 0.1  # m, authors' precursor
MIN_INSET = 0.3  # m from start and goal to a wall; the planner finds no path from closer points


@dataclass(frozen=True)
class Layout:
    """World without pedestrians.

    Args:
        boxes: ``[W, 5]`` axis-aligned walls, m.
        extent: (x0, y0, x1, y1) m.
        start: ``[2]`` m.
        goal: ``[2]`` m.
    """

    boxes: np.ndarray
    extent: tuple[float, float, float, float]
    start: np.ndarray
    goal: np.ndarray


class World(Protocol):
    """Interface of layout generators; the class attribute ``kind`` names the kind of world."""

    kind: str

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        ...


def check_inset(inset: float, max_inset: float) -> float:
    """Return ``inset`` if the planner can start there and it is within half the world.

    Raises:
        ValueError: If it is outside the allowed range.
    """
    if not MIN_INSET <= inset <= max_inset:
        raise ValueError(f"inset={inset}: must be in {MIN_INSET} to {max_inset:.3g} m")
    return float(inset)


def wall(x0: float, y0: float, x1: float, y1: float) -> list[float]:
    """Return the box around a straight, axis-aligned wall's center line, with square ends."""
    half = WALL_THICKNESS / 2
    return [
        (x0 + x1) / 2,
        (y0 + y1) / 2,
        abs(x1 - x0) / 2 + half,
        abs(y1 - y0) / 2 + half,
        0.0,
    ]


def check_range(name: str, bounds: tuple[float, float]) -> tuple[float, float]:
    """Return ``bounds`` as a pair if both are positive and ordered.

    Raises:
        ValueError: If they are not, with ``name`` in the message.
    """
    low, high = bounds
    if not 0 < low <= high:
        raise ValueError(f"{name}={list(bounds)}: must be 0 < low <= high")
    return float(low), float(high)
