"""Cards in a straight hallway."""

from __future__ import annotations

import numpy as np

from navrl.worlds.cards.card import meeting
from navrl.worlds.layout import WALL_THICKNESS, Layout, check_range, wall
from navrl.worlds.scenario import Pedestrian


class _Hallway:
    """Closed hallway along x; start and goal near its ends."""

    def __init__(
        self,
        length: tuple[float, float],
        width: tuple[float, float],
        speed: tuple[float, float],
    ) -> None:
        self.length, self.width = check_range("length", length), check_range("width", width)
        self.speed = check_range("speed", speed)
        if self.width[0] < 1.1 or self.length[0] < 4.0:
            raise ValueError(
                f"width={list(width)}: must be >= 1.1 m; length={list(length)}: must be >= 4 m"
            )

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        x, y = generator.uniform(*self.length) / 2, generator.uniform(*self.width) / 2
        aside = min(0.2, y - 0.55)
        start, goal = ([side * (x - 0.5), generator.uniform(-aside, aside)] for side in (-1, 1))
        x, y = x + WALL_THICKNESS / 2, y + WALL_THICKNESS / 2  # the walls' center lines
        boxes = [wall(-x, -y, x, -y), wall(-x, y, x, y), wall(-x, -y, -x, y), wall(x, -y, x, y)]
        return Layout(np.array(boxes), (-x, -y, x, y), np.array(start), np.array(goal))


class FrontalApproach(_Hallway):
    """Card: a pedestrian walks towards the robot in a hallway wide enough for both.

    Args:
        length: (min, max) m, clear.
        width: (min, max) m, clear.
        speed: (min, max) m/s of the pedestrian.

    Raises:
        ValueError: If a range is not positive or not ordered, or the hallway is too small.
    """

    kind = "frontal_approach"

    def __init__(
        self,
        length: tuple[float, float] = (8.0, 10.0),
        width: tuple[float, float] = (2.0, 2.5),
        speed: tuple[float, float] = (0.5, 1.0),
    ) -> None:
        super().__init__(length, width, speed)

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the pedestrian, who comes from the goal, up to 0.2 m beside the path."""
        route = path[::-1] + np.array([0.0, generator.uniform(-0.2, 0.2)])
        speed = generator.uniform(*self.speed)
        return [meeting(generator, route, speed, path, generator.uniform(0.4, 0.6))]


class NarrowHallway(_Hallway):
    """Card: a pedestrian walks towards the robot where the two can barely pass.

    Args:
        length: (min, max) m, clear.
        width: (min, max) m, clear.
        speed: (min, max) m/s of the pedestrian.

    Raises:
        ValueError: If a range is not positive or not ordered, or the hallway is too small.
    """

    kind = "narrow_hallway"

    def __init__(
        self,
        length: tuple[float, float] = (6.0, 8.0),
        width: tuple[float, float] = (1.3, 1.5),
        speed: tuple[float, float] = (0.4, 0.7),
    ) -> None:
        super().__init__(length, width, speed)

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the pedestrian, who stays on one side, 0.3 m off the middle."""
        x = np.abs(path[:, 0]).max()
        y = 0.3 * generator.choice([-1.0, 1.0])
        speed = generator.uniform(*self.speed)
        return [meeting(generator, np.array([[x, y], [-x, y]]), speed, path, 0.5)]


class Overtaking(_Hallway):
    """Card: a slower pedestrian walks ahead of the robot in the same direction.

    Args:
        length: (min, max) m, clear.
        width: (min, max) m, clear.
        speed: (min, max) m/s of the pedestrian.

    Raises:
        ValueError: If a range is not positive or not ordered, or the hallway is too small.
    """

    kind = "overtaking"

    def __init__(
        self,
        length: tuple[float, float] = (9.0, 11.0),
        width: tuple[float, float] = (2.0, 2.5),
        speed: tuple[float, float] = (0.25, 0.4),
    ) -> None:
        super().__init__(length, width, speed)

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the pedestrian, who starts 1.5 to 2 m ahead, up to 0.2 m beside the path."""
        ahead = round(generator.uniform(15, 20))
        route = path[ahead:] + np.array([0.0, generator.uniform(-0.2, 0.2)])
        return [Pedestrian(route[[0, -1]], float(generator.uniform(*self.speed)), 0.0)]
