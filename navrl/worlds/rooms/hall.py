"""Open halls and plazas: posts and clutter in a large room, with walls often out of sight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from navrl.worlds.layout import check_range, wall
from navrl.worlds.places.place import Place
from navrl.worlds.rooms.furniture import Piece, block, draw_clutter, draw_wall_piece
from navrl.worlds.rooms.placing import Furnisher

_POST_M = (0.08, 0.35)  # m, radius of a round post, half side of a square one
_AISLE_M = 0.9  # m, free width around a post


class Hall:
    """Generator of halls.

    Args:
        length: (min, max), m.
        width: (min, max), m.
        posts: (min, max) round and square posts.
        groups: (min, max) groups of 2 to 6 small pieces around a free spot.
        clutter: (min, max) single pieces.

    Raises:
        ValueError: If a range is not ordered and positive (counts: not negative).

    Example:
        >>> place = Hall(posts=(3, 3)).place(np.random.default_rng(0), "hall")
        >>> len(place.walls) >= 4
        True
    """

    kind = "hall"

    def __init__(
        self,
        length: Sequence[float] = (9.0, 20.0),
        width: Sequence[float] = (7.0, 14.0),
        posts: Sequence[int] = (0, 8),
        groups: Sequence[int] = (0, 4),
        clutter: Sequence[int] = (0, 10),
    ) -> None:
        """Check the values."""
        self.length = check_range("length", (length[0], length[1]))
        self.width = check_range("width", (width[0], width[1]))
        for name, bounds in (("posts", posts), ("groups", groups), ("clutter", clutter)):
            if not 0 <= bounds[0] <= bounds[1]:
                raise ValueError(f"{name}={list(bounds)}: must be 0 <= low <= high")
        self.posts, self.groups, self.clutter = tuple(posts), tuple(groups), tuple(clutter)

    def place(self, generator: np.random.Generator, name: str) -> Place:
        """Draw a hall."""
        floor = Furnisher(generator)
        x1, y1 = generator.uniform(*self.length), generator.uniform(*self.width)
        for ends in ((0, 0, x1, 0), (0, y1, x1, y1), (0, 0, 0, y1), (x1, 0, x1, y1)):
            floor.walls.append(wall(*ends))
        room = np.array([0.05, 0.05, x1 - 0.05, y1 - 0.05])
        for _ in range(_count(generator, self.posts)):
            _post(floor, room)
        for _ in range(_count(generator, self.groups)):
            _group(floor, room)
        for _ in range(_count(generator, self.clutter)):
            draw = draw_clutter if generator.random() < 0.7 else draw_wall_piece
            x, y = generator.uniform(room[:2], room[2:])
            floor.put(draw(generator), float(x), float(y), _turn(generator), room)
        return floor.place(name)


def _count(generator: np.random.Generator, bounds: tuple[int, ...]) -> int:
    return int(generator.integers(bounds[0], bounds[1] + 1))


def _turn(generator: np.random.Generator) -> float:
    """Return a yaw, rad."""
    return float(generator.uniform(-np.pi, np.pi))


def _post(floor: Furnisher, room: np.ndarray) -> None:
    """Place a round or square post with an aisle around it, if it fits."""
    generator = floor.generator
    size = float(generator.uniform(*_POST_M))
    x, y = generator.uniform(room[:2], room[2:])
    half = np.full(2, size + _AISLE_M)
    if not floor.is_free(np.array([x, y]) - half, np.array([x, y]) + half):
        return
    if generator.random() < 0.5:
        floor.discs.append([float(x), float(y), size])
        floor.reserve(np.array([x, y]) - size, np.array([x, y]) + size)
    else:
        post: Piece = block("post", 2 * size, 2 * size, 2.5)
        floor.put(post, float(x), float(y), _turn(generator))


def _group(floor: Furnisher, room: np.ndarray) -> None:
    """Place small pieces on several sides of a free spot."""
    generator = floor.generator
    center = generator.uniform(room[:2], room[2:])
    reach = generator.uniform(0.9, 1.6)  # m
    for angle in generator.uniform(-np.pi, np.pi, size=generator.integers(2, 7)):
        at = center + reach * np.array([np.cos(angle), np.sin(angle)])
        floor.put(draw_clutter(generator), float(at[0]), float(at[1]), _turn(generator), room)
