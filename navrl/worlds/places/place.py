"""Place: walls, furniture with heights and free region, without robot and pedestrians."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from navrl.worlds.pedestrian import Pedestrian


def turned(points: np.ndarray, yaw: float) -> np.ndarray:
    """Return points ``[*B, 2]`` turned around (0, 0)."""
    if yaw == 0.0:
        return points
    cos, sin = math.cos(yaw), math.sin(yaw)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


@dataclass(frozen=True)
class FreeRegion:
    """Cells that a robot can reach.

    Args:
        origin: ``[2]`` m, corner of the cell (0, 0).
        cell: Size of a cell, m.
        mask: ``[X, Y]`` bool.
        yaw: Angle by which the cells are turned around the origin, rad.
    """

    origin: np.ndarray
    cell: float
    mask: np.ndarray
    yaw: float = 0.0

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return whether points ``[*B, 2]`` m are in the region, ``[*B]`` bool."""
        offsets = np.asarray(points) - self.origin
        cells = np.floor(turned(offsets, -self.yaw) / self.cell).astype(int)
        inside = ((cells >= 0) & (cells < self.mask.shape)).all(-1)
        cells = cells.clip(0, np.array(self.mask.shape) - 1)
        return inside & self.mask[cells[..., 0], cells[..., 1]]


@dataclass(frozen=True)
class Place:
    """Place of a file.

    Args:
        name: Name of the place; results are listed by it.
        walls: ``[W, 5]`` boxes (cx, cy, hx, hy, yaw), m and rad.
        wall_height: m.
        furniture: ``[F, 5]`` boxes.
        furniture_heights: ``[F, 2]`` m, bottom and top.
        furniture_names: F names of classes, e.g. ``Table``.
        discs: ``[D, 3]`` round furniture (cx, cy, radius), m.
        disc_heights: ``[D, 2]`` m.
        free: Region of starts and goals; ``None`` for all that is reachable.
        start: ``[3]`` pose of the robot; ``None`` draws one.
        goal: ``[2]`` m; ``None`` draws one.
        people: Recorded pedestrians, times in s since the start of the recording.
        limits: ``[L, 5]`` boxes that paths avoid although nothing is there: the edges of what is
            known of a place.

    Raises:
        ValueError: If there is no wall and no furniture, or a number of rows does not fit.
    """

    name: str
    walls: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))
    wall_height: float = 2.5
    furniture: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))
    furniture_heights: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    furniture_names: tuple[str, ...] = ()
    discs: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    disc_heights: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    free: FreeRegion | None = None
    start: np.ndarray | None = None
    goal: np.ndarray | None = None
    people: tuple[Pedestrian, ...] = ()
    limits: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))

    def __post_init__(self) -> None:
        """Check the numbers of rows."""
        if not len(self.walls) + len(self.furniture) + len(self.discs):
            raise ValueError(f"place {self.name}: must have a wall or a piece of furniture")
        for name, count in (
            ("furniture_heights", len(self.furniture)),
            ("furniture_names", len(self.furniture)),
            ("disc_heights", len(self.discs)),
        ):
            if len(getattr(self, name)) != count:
                found = len(getattr(self, name))
                raise ValueError(f"place {self.name}: {name} must have {count} rows, got {found}")

    @cached_property
    def boxes(self) -> np.ndarray:
        """Walls, then furniture, ``[W + F, 5]``."""
        return np.concatenate([self.walls, self.furniture])

    @cached_property
    def heights(self) -> np.ndarray:
        """Bottom and top of each box and then each disc, ``[W + F + D, 2]`` m."""
        walls = np.tile([0.0, self.wall_height], (len(self.walls), 1))
        return np.concatenate([walls, self.furniture_heights, self.disc_heights])

    @property
    def num_furniture(self) -> int:
        """Number of pieces of furniture, discs included."""
        return len(self.furniture) + len(self.discs)
