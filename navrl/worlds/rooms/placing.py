"""Placement of pieces on a floor: no overlaps, and nothing in front of doors."""

from __future__ import annotations

import numpy as np

from navrl.worlds.places.place import Place
from navrl.worlds.rooms.furniture import Piece


class Furnisher:
    """Collector of walls and pieces that do not overlap.

    Footprints are compared as axis-aligned rectangles, also those of turned pieces.

    Args:
        generator: Source of all randomness.
    """

    def __init__(self, generator: np.random.Generator) -> None:
        """Begin with an empty floor."""
        self.generator = generator
        self.walls: list[list[float]] = []
        self.pieces: list[Piece] = []
        self.discs: list[list[float]] = []
        self._taken: list[np.ndarray] = []

    def reserve(self, low: np.ndarray, high: np.ndarray) -> None:
        """Reserve a rectangle, m, in which no piece is placed later."""
        self._taken.append(np.array([*low, *high]))

    def is_free(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Return whether a rectangle, m, overlaps no other one."""
        if not self._taken:
            return True
        taken = np.array(self._taken)
        return not bool(((taken[:, :2] < high) & (taken[:, 2:] > low)).all(1).any())

    def put(
        self, piece: Piece, x: float, y: float, yaw: float, room: np.ndarray | None = None
    ) -> bool:
        """Place a piece if its footprint is free and inside ``room`` (x0, y0, x1, y1), m."""
        cos, sin = abs(np.cos(yaw)), abs(np.sin(yaw))
        half = np.array([[cos, sin], [sin, cos]]) @ piece.half_size
        low, high = np.array([x, y]) - half, np.array([x, y]) + half
        if room is not None and ((low < room[:2] - 1e-9) | (high > room[2:] + 1e-9)).any():
            return False
        if not self.is_free(low, high):
            return False
        self.reserve(low, high)
        self.pieces.append(piece.at(x, y, yaw))
        return True

    def place(self, name: str) -> Place:
        """Return the place of everything placed so far."""
        walls = np.array(self.walls, dtype=float).reshape(-1, 5)
        boxes = np.concatenate([np.zeros((0, 5)), *(piece.boxes for piece in self.pieces)])
        heights = np.concatenate([np.zeros((0, 2)), *(piece.heights for piece in self.pieces)])
        names = tuple(piece.name for piece in self.pieces for _ in piece.boxes)
        discs = np.array(self.discs, dtype=float).reshape(-1, 3)
        return Place(
            name,
            walls,
            furniture=boxes,
            furniture_heights=heights,
            furniture_names=names,
            discs=discs,
            disc_heights=np.tile([0.0, 2.5], (len(discs), 1)),
        )
