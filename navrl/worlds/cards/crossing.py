"""Cards with crossing paths."""

from __future__ import annotations

import numpy as np

from navrl.worlds.cards.card import meeting
from navrl.worlds.layout import WALL_THICKNESS, Layout, check_range, wall
from navrl.worlds.scenario import Pedestrian


class _Hall:
    """Square hall without inner walls; start and goal are opposite each other."""

    def __init__(self, size: tuple[float, float], speed: tuple[float, float]) -> None:
        self.size, self.speed = check_range("size", size), check_range("speed", speed)
        if self.size[0] < 5.0:
            raise ValueError(f"size={list(size)}: must be >= 5 m")

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        half = generator.uniform(*self.size) / 2
        reach, h = half - 0.7, half + WALL_THICKNESS / 2  # h: the walls' center lines
        boxes = [wall(-h, -h, h, -h), wall(-h, h, h, h), wall(-h, -h, -h, h), wall(h, -h, h, h)]
        start, goal = np.array([-reach, 0.0]), np.array([reach, 0.0])
        return Layout(np.array(boxes), (-h, -h, h, h), start, goal)


class Crossing(_Hall):
    """Card: a pedestrian crosses the robot's path at a right angle in open space.

    Args:
        size: (min, max) m, side of the hall.
        speed: (min, max) m/s of the pedestrian.

    Raises:
        ValueError: If a range is not positive or not ordered, or the hall is too small.
    """

    kind = "crossing"

    def __init__(
        self, size: tuple[float, float] = (6.0, 8.0), speed: tuple[float, float] = (0.5, 1.0)
    ) -> None:
        super().__init__(size, speed)

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the pedestrian, which crosses within 1 m of the path's middle."""
        x, reach = generator.uniform(-1.0, 1.0), path[-1, 0]
        side = generator.choice([-1.0, 1.0])
        route = np.array([[x, -side * reach], [x, side * reach]])
        at = (x + reach) / (2 * reach)
        return [meeting(generator, route, generator.uniform(*self.speed), path, at)]


class CircularCrossing(_Hall):
    """Card: the robot and several pedestrians cross a circle simultaneously.

    Args:
        size: (min, max) m, side of the hall.
        speed: (min, max) m/s of the pedestrians.
        num_people: (min, max) pedestrians.

    Raises:
        ValueError: If a range is not positive or not ordered, or the hall is too small.
    """

    kind = "circular_crossing"

    def __init__(
        self,
        size: tuple[float, float] = (7.0, 8.0),
        speed: tuple[float, float] = (0.5, 0.9),
        num_people: tuple[int, int] = (3, 5),
    ) -> None:
        super().__init__(size, speed)
        low, high = num_people
        if not 1 <= low <= high <= 7:
            raise ValueError(f"num_people={list(num_people)}: must be 1 <= min <= max <= 7")
        self.num_people = (int(low), int(high))

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the pedestrians evenly around the circle, each up to 0.3 m off its diameter."""
        count = int(generator.integers(self.num_people[0], self.num_people[1] + 1))
        found = []
        for k in range(1, count + 1):
            angle = np.pi + 2 * np.pi * k / (count + 1)  # the robot starts at pi
            along = path[-1, 0] * np.array([np.cos(angle), np.sin(angle)])
            across = np.array([-np.sin(angle), np.cos(angle)]) * generator.uniform(-0.3, 0.3)
            route = np.stack([along, -along]) + across
            found.append(Pedestrian(route, float(generator.uniform(*self.speed)), 0.0))
        return found


class BlindCorner:
    """Card: an occluded pedestrian comes around the corner of an L-shaped hallway.

    Args:
        width: (min, max) m of both hallways, clear.
        arm: (min, max) m from the corner's middle to each end.
        speed: (min, max) m/s of the pedestrian.

    Raises:
        ValueError: If a range is not positive or not ordered, or an arm ends in the corner.
    """

    kind = "blind_corner"

    def __init__(
        self,
        width: tuple[float, float] = (2.0, 2.5),
        arm: tuple[float, float] = (4.5, 6.0),
        speed: tuple[float, float] = (0.5, 1.0),
    ) -> None:
        self.width, self.arm = check_range("width", width), check_range("arm", arm)
        self.speed = check_range("speed", speed)
        if self.width[0] < 1.1 or self.arm[0] < self.width[1] / 2 + 2.0:
            raise ValueError(
                f"width={list(width)}: must be >= 1.1 m; "
                f"arm={list(arm)}: must be >= width / 2 + 2 m"
            )

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout: from the left end to the upper end."""
        half = generator.uniform(*self.width) / 2
        left, up = generator.uniform(*self.arm, size=2)
        start, goal = np.array([0.5 - left, 0.0]), np.array([0.0, up - 0.5])
        h, x, y = (v + WALL_THICKNESS / 2 for v in (half, left, up))  # the walls' center lines
        boxes = [wall(-x, -h, h, -h), wall(h, -h, h, y), wall(-x, h, -h, h), wall(-h, h, -h, y)]
        boxes += [wall(-x, -h, -x, h), wall(-h, y, h, y)]
        return Layout(np.array(boxes), (-x, -h, h, y), start, goal)

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the pedestrian, who walks the robot's path backwards to meet it near the corner."""
        corner = float(np.linalg.norm(path, axis=-1).argmin()) / (len(path) - 1)
        at = np.clip(corner + generator.uniform(-0.08, 0.08), 0.0, 1.0)
        return [meeting(generator, path[::-1], generator.uniform(*self.speed), path, at)]
