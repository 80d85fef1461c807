"""Office of rooms connected by doorways."""

from __future__ import annotations

import numpy as np

from navrl.worlds.layout import WALL_THICKNESS, Layout, check_inset, wall

_MIN_DOOR = 0.7  # m; narrower ones have no cell with the planner's clearance
Room = tuple[float, float, float, float]
Door = tuple[float, float]  # its ends along the wall, m


class Office:
    """Square office, split at random into rooms; start and goal in opposite corners.

    A wall with a doorway halves the square, and another one may halve each half across.

    Args:
        size: Outer side including walls, m.
        door: Clear width of a doorway, m.
        min_room: Minimum side of a room between the center lines of its walls, m.
        inset: Distance of start and goal to the walls of their corners, m.

    Raises:
        ValueError: If the robot does not fit through a door, a door into the smallest room, two
            rooms into the office, or ``inset`` into a room.

    Reference:
        Paper Sec. IV-F: fixed outer size, random inner walls, doorways. 7 m and 1.1 m are the
        authors' precursor's.
    """

    kind = "office"

    def __init__(
        self, size: float = 7.0, door: float = 1.1, min_room: float = 2.2, inset: float = 0.5
    ) -> None:
        fits = _MIN_DOOR <= door < min_room - 4 * WALL_THICKNESS
        if not fits or not 2 * min_room <= size - WALL_THICKNESS:
            raise ValueError(
                f"door={door}, min_room={min_room}, size={size}: must be {_MIN_DOOR} <= door, "
                "door < min_room - 0.4 and 2 min_room <= size - 0.1"
            )
        self.size, self.door, self.min_room = size, door, min_room
        self.inset = check_inset(inset, (min_room - WALL_THICKNESS) / 2)

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        half = (self.size - WALL_THICKNESS) / 2  # to the outer walls' center lines
        boxes = [
            wall(-half, -half, half, -half),
            wall(-half, half, half, half),
            wall(-half, -half, -half, half),
            wall(half, -half, half, half),
        ]
        first = int(generator.integers(2))
        cut = generator.uniform(-half + self.min_room, half - self.min_room)
        door = self._door(generator, -half, half)
        boxes += _split(first, cut, -half, half, door)
        for low, high in ((-half, cut), (cut, half)):
            if generator.random() < 0.15:
                continue  # some rooms are not split
            cross = self._cut_beside(generator, -half, half, door)
            if cross is not None:
                inner = self._door(generator, low, high)
                boxes += _split(1 - first, cross, low, high, inner)
        corner = (half - WALL_THICKNESS / 2 - self.inset) * generator.choice([-1.0, 1.0], size=2)
        return Layout(np.array(boxes), (-half, -half, half, half), corner, -corner)

    def _door(self, generator: np.random.Generator, low: float, high: float) -> Door:
        margin = self.door / 2 + 2 * WALL_THICKNESS
        center = generator.uniform(low + margin, high - margin)
        return center - self.door / 2, center + self.door / 2

    def _cut_beside(
        self, generator: np.random.Generator, low: float, high: float, door: Door
    ) -> float | None:
        """Draw the position of a wall on the first one, away from its doorway."""
        gap = 2 * WALL_THICKNESS
        spans = [
            (low + self.min_room, min(door[0] - gap, high - self.min_room)),
            (max(door[1] + gap, low + self.min_room), high - self.min_room),
        ]
        spans = [(a, b) for a, b in spans if b > a]
        if not spans:
            return None
        lengths = np.array([b - a for a, b in spans])
        a, b = spans[generator.choice(len(spans), p=lengths / lengths.sum())]
        return generator.uniform(a, b)


def _split(axis: int, at: float, low: float, high: float, door: Door) -> list[list[float]]:
    """Return the two segments of a wall across ``axis`` with a doorway."""
    half = WALL_THICKNESS / 2
    pieces = ((low, door[0] - half), (door[1] + half, high))
    if axis == 0:
        return [wall(at, a, at, b) for a, b in pieces]
    return [wall(a, at, b, at) for a, b in pieces]
