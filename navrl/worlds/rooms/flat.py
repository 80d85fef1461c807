"""Furnished flats: rooms with doors, furniture along walls, tables with chairs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from navrl.worlds.layout import WALL_THICKNESS, check_range, wall
from navrl.worlds.places.place import Place
from navrl.worlds.rooms.furniture import (
    draw_chair,
    draw_clutter,
    draw_table,
    draw_wall_piece,
)
from navrl.worlds.rooms.placing import Furnisher

_LEAST_SIDE_M = 2.4  # m of a room
_DOOR_FRAME_M = 0.25  # m from a door to a corner
_DOOR_DEPTH_M = 0.7  # m before and behind a door, without furniture


class Flat:
    """Generator of flats: a rectangle is divided by walls with one door each, and furnished.

    Args:
        length: (min, max) of the flat, m.
        width: (min, max), m.
        room_area: Rooms larger than this are divided, m^2.
        door: (min, max) clear width of doors, m.
        density: (min, max) pieces along the walls per m^2 of a room; those that do not fit are left
            out.
        tables: (min, max) tables with chairs per room.
        clutter: (min, max) small pieces per room that stand anywhere.

    Raises:
        ValueError: If a range is not ordered and positive (counts: not negative), or a door does
            not fit.

    Example:
        >>> place = Flat().place(np.random.default_rng(0), "flat")
        >>> {"table", "chair"} <= set(place.furniture_names)
        True
    """

    kind = "furnished"

    def __init__(
        self,
        length: Sequence[float] = (7.0, 14.0),
        width: Sequence[float] = (5.0, 9.0),
        room_area: float = 14.0,
        door: Sequence[float] = (0.72, 1.0),
        density: Sequence[float] = (0.4, 1.2),
        tables: Sequence[int] = (0, 2),
        clutter: Sequence[int] = (0, 3),
    ) -> None:
        """Check the values."""
        self.length = check_range("length", (length[0], length[1]))
        self.width = check_range("width", (width[0], width[1]))
        self.door = check_range("door", (door[0], door[1]))
        if self.door[1] + 2 * _DOOR_FRAME_M > _LEAST_SIDE_M:
            most = _LEAST_SIDE_M - 2 * _DOOR_FRAME_M
            raise ValueError(f"door={list(self.door)}: must be <= {most} m")
        for name, bounds in (("density", density), ("tables", tables), ("clutter", clutter)):
            if not 0 <= bounds[0] <= bounds[1]:
                raise ValueError(f"{name}={list(bounds)}: must be 0 <= low <= high")
        self.room_area, self.density = room_area, (density[0], density[1])
        self.tables, self.clutter = tuple(tables), tuple(clutter)

    def place(self, generator: np.random.Generator, name: str) -> Place:
        """Draw a flat."""
        floor = Furnisher(generator)
        x1, y1 = generator.uniform(*self.length), generator.uniform(*self.width)
        for ends in ((0, 0, x1, 0), (0, y1, x1, y1), (0, 0, 0, y1), (x1, 0, x1, y1)):
            floor.walls.append(wall(*ends))
        rooms: list[np.ndarray] = []
        self._divide(floor, np.array([0.0, 0.0, x1, y1]), np.zeros((0, 2)), rooms)
        for room in rooms:
            self._furnish(floor, room)
        return floor.place(name)

    def _divide(
        self, floor: Furnisher, room: np.ndarray, doors: np.ndarray, rooms: list[np.ndarray]
    ) -> None:
        """Divide a room by a wall with a door until rooms are small enough.

        ``doors`` ``[D, 2]`` m are the centers of the doors so far, at which no wall may end.
        """
        size = room[2:] - room[:2]
        axis = int(size[1] > size[0])  # across the longer side
        low, high = room[axis] + _LEAST_SIDE_M, room[axis + 2] - _LEAST_SIDE_M
        cut = float(floor.generator.uniform(low, high)) if low < high else np.nan
        apart = self.door[1] / 2 + WALL_THICKNESS
        near = (doors > room[:2] - apart).all(1) & (doors < room[2:] + apart).all(1)
        blocked = np.abs(doors[near, axis] - cut) < apart
        if size.prod() <= self.room_area or not low < high or blocked.any():
            rooms.append(room)
            return
        center = self._wall_with_door(floor, room, axis, cut)
        doors = np.concatenate([doors, center[None]])
        first, second = room.copy(), room.copy()
        first[axis + 2] = second[axis] = cut
        self._divide(floor, first, doors, rooms)
        self._divide(floor, second, doors, rooms)

    def _wall_with_door(
        self, floor: Furnisher, room: np.ndarray, axis: int, cut: float
    ) -> np.ndarray:
        """Add a wall across ``axis`` with a door, and return the center of the door ``[2]`` m."""
        across, half_wall = 1 - axis, WALL_THICKNESS / 2
        width = float(floor.generator.uniform(*self.door))
        start, end = room[across], room[across + 2]
        frame = _DOOR_FRAME_M + width / 2
        at = float(floor.generator.uniform(start + frame, end - frame))
        gap = width / 2 + half_wall  # the ends of a wall are square
        for a, b in ((start, at - gap), (at + gap, end)):
            ends = (cut, a, cut, b) if axis == 0 else (a, cut, b, cut)
            floor.walls.append(wall(*ends))
        center = np.array([cut, at]) if axis == 0 else np.array([at, cut])
        half = np.array([_DOOR_DEPTH_M, width / 2])[[axis, across]]
        floor.reserve(center - half, center + half)
        return center

    def _furnish(self, floor: Furnisher, room: np.ndarray) -> None:
        """Place pieces along the walls, tables with chairs, and clutter."""
        generator = floor.generator
        inner = room + np.array([1, 1, -1, -1]) * WALL_THICKNESS / 2
        area = float((room[2:] - room[:2]).prod())
        for _ in range(round(area * generator.uniform(*self.density))):
            _along_a_wall(floor, inner)
        for _ in range(int(generator.integers(self.tables[0], self.tables[1] + 1))):
            _table_with_chairs(floor, inner)
        for _ in range(int(generator.integers(self.clutter[0], self.clutter[1] + 1))):
            x, y = generator.uniform(inner[:2], inner[2:])
            yaw = generator.uniform(-np.pi, np.pi)
            floor.put(draw_clutter(generator), float(x), float(y), float(yaw), inner)


def _along_a_wall(floor: Furnisher, room: np.ndarray) -> None:
    """Place a piece with its back to a random wall, at most 5 cm from it, if it fits."""
    generator = floor.generator
    piece, side = draw_wall_piece(generator), int(generator.integers(4))
    depth = piece.half_size[0] + generator.uniform(0.0, 0.05)
    x, y = generator.uniform(room[:2], room[2:])
    x, y = ((room[0] + depth, y), (x, room[1] + depth), (room[2] - depth, y), (x, room[3] - depth))[
        side
    ]
    floor.put(piece, float(x), float(y), side * np.pi / 2, room)


def _table_with_chairs(floor: Furnisher, room: np.ndarray) -> None:
    """Place a table and up to four chairs around it, if it fits."""
    generator = floor.generator
    table, turned = draw_table(generator), int(generator.integers(2)) * np.pi / 2
    yaw = turned + generator.normal(0.0, 0.1)
    x, y = generator.uniform(room[:2], room[2:])
    if not floor.put(table, float(x), float(y), float(yaw), room):
        return
    for side in generator.permutation(4)[: generator.integers(0, 5)]:
        chair = draw_chair(generator)
        away = table.half_size[side % 2] + chair.half_size[0] + generator.uniform(0.02, 0.25)
        toward = yaw + side * np.pi / 2
        at = np.array([x, y]) + away * np.array([np.cos(toward), np.sin(toward)])
        turn = toward + np.pi + generator.normal(0.0, 0.3)  # the seat faces the table
        floor.put(chair, float(at[0]), float(at[1]), float(turn), room)
