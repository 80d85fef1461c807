"""Pieces of furniture as boxes with heights: what a lidar sees and what a hull touches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

_LEG_M = (0.012, 0.035)  # m, half side of a leg
_TOP_M = 0.04  # m, thickness of a plate


@dataclass(frozen=True)
class Piece:
    """Piece of furniture at a position.

    Args:
        name: Its class, e.g. ``table``.
        boxes: ``[P, 5]`` parts (cx, cy, hx, hy, yaw), m and rad.
        heights: ``[P, 2]`` m over the floor, bottom and top.
        half_size: ``[2]`` m, half depth and half width of the footprint, which contains all parts.
    """

    name: str
    boxes: np.ndarray
    heights: np.ndarray
    half_size: np.ndarray

    def at(self, x: float, y: float, yaw: float) -> Piece:
        """Return the piece, whose own pose is (0, 0, 0), at another pose, m and rad."""
        cos, sin = math.cos(yaw), math.sin(yaw)
        boxes = self.boxes.copy()
        boxes[:, 0] = x + cos * self.boxes[:, 0] - sin * self.boxes[:, 1]
        boxes[:, 1] = y + sin * self.boxes[:, 0] + cos * self.boxes[:, 1]
        boxes[:, 4] += yaw
        return Piece(self.name, boxes, self.heights, self.half_size)


def block(name: str, depth: float, width: float, height: float) -> Piece:
    """Return a solid piece from the floor up, such as a cupboard or a box, m."""
    half = np.array([depth, width]) / 2
    return Piece(name, np.array([[0.0, 0.0, *half, 0.0]]), np.array([[0.0, height]]), half)


def plate_on_legs(
    name: str, depth: float, width: float, height: float, leg: float, is_open: bool = True
) -> Piece:
    """Return a plate on four legs, such as a table.

    Args:
        name: Class of the piece.
        depth: m.
        width: m.
        height: Of the upper side, m.
        leg: Half side of a leg, m.
        is_open: False closes the back between the legs from the floor to the top, as of a desk.
    """
    half = np.array([depth, width]) / 2
    x, y = half - leg
    legs = [[i * x, j * y, leg, leg, 0.0] for i in (-1, 1) for j in (-1, 1)]
    boxes = [*legs, [0.0, 0.0, *half, 0.0]]
    heights = [[0.0, height - _TOP_M]] * 4 + [[height - _TOP_M, height]]
    if not is_open:
        boxes.append([-x, 0.0, leg, half[1], 0.0])
        heights.append([0.0, height])
    return Piece(name, np.array(boxes), np.array(heights), half)


def chair(depth: float, height: float, leg: float) -> Piece:
    """Return a square chair with a backrest at its rear; ``height`` of the seat, m."""
    seat = plate_on_legs("chair", depth, depth, height, leg)
    half = depth / 2
    back = [[leg - half, 0.0, leg, half, 0.0]]
    boxes = np.concatenate([seat.boxes, back])
    heights = np.concatenate([seat.heights, [[height, 2.0 * height]]])
    return Piece("chair", boxes, heights, seat.half_size)


def draw_leg(generator: np.random.Generator) -> float:
    """Return the half side of a leg, m."""
    return float(generator.uniform(*_LEG_M))


def draw_chair(generator: np.random.Generator) -> Piece:
    """Return a chair."""
    depth, height = generator.uniform(0.4, 0.5), generator.uniform(0.43, 0.48)
    return chair(float(depth), float(height), draw_leg(generator))


def draw_table(generator: np.random.Generator) -> Piece:
    """Return a dining or coffee table; the robot fits under the first, not under the second."""
    depth, width = generator.uniform(0.6, 1.0), generator.uniform(0.7, 1.8)
    height = generator.choice([0.45, 0.74])
    return plate_on_legs("table", float(depth), float(width), float(height), draw_leg(generator))


def draw_wall_piece(generator: np.random.Generator) -> Piece:
    """Return a piece that stands with its back to a wall."""
    name = generator.choice(["cupboard", "shelf", "bed", "sofa", "desk", "chair", "box"])
    if name == "chair":
        return draw_chair(generator)
    depth, width, height = (float(generator.uniform(*bounds)) for bounds in _WALL_PIECES[name])
    if name == "desk":
        is_open = bool(generator.random() < 0.5)
        return plate_on_legs("desk", depth, width, height, draw_leg(generator), is_open)
    return block(str(name), depth, width, height)


def draw_clutter(generator: np.random.Generator) -> Piece:
    """Return a small piece that stands anywhere: a box, a chair or a stool."""
    if generator.random() < 0.4:
        return draw_chair(generator)
    depth, width = generator.uniform(0.15, 0.7, size=2)
    return block("box", float(depth), float(width), float(generator.uniform(0.3, 1.5)))


_WALL_PIECES = {  # depth, width and height, m, of common furniture
    "cupboard": ((0.4, 0.65), (0.6, 2.0), (0.8, 2.0)),
    "shelf": ((0.25, 0.4), (0.6, 1.6), (1.0, 2.0)),
    "bed": ((1.9, 2.1), (0.8, 1.6), (0.4, 0.6)),
    "sofa": ((0.8, 0.95), (1.2, 2.2), (0.7, 0.9)),
    "desk": ((0.6, 0.8), (1.0, 1.6), (0.72, 0.76)),
    "box": ((0.2, 0.6), (0.2, 0.6), (0.3, 1.0)),
}
