"""Cards of two rooms joined by a doorway."""

from __future__ import annotations

import numpy as np

from navrl.worlds.cards.card import meeting
from navrl.worlds.layout import WALL_THICKNESS, Layout, check_range, wall
from navrl.worlds.scenario import Pedestrian


class _Doorway:
    """Two adjacent rooms with the doorway at the origin, start left and goal right of it."""

    def __init__(self, room: tuple[float, float], door: tuple[float, float]) -> None:
        self.room, self.door = check_range("room", room), check_range("door", door)
        if not 0.8 <= self.door[0] <= self.door[1] <= self.room[0] - 2.0:
            raise ValueError(
                f"door={list(door)}: must be in 0.8 to room - 2 = {self.room[0] - 2.0:.3g} m"
            )

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        half = generator.uniform(*self.room) / 2  # of each room's sides
        half_door = generator.uniform(*self.door) / 2
        start = np.array([-2 * half + 0.6, generator.uniform(0.3, half - 0.7)])
        goal = np.array([2 * half - 0.6, generator.uniform(0.3, half - 0.7)])
        x, y = 2 * half + WALL_THICKNESS / 2, half + WALL_THICKNESS / 2  # the walls' center lines
        post = half_door + WALL_THICKNESS / 2
        boxes = [wall(-x, -y, x, -y), wall(-x, y, x, y), wall(-x, -y, -x, y), wall(x, -y, x, y)]
        boxes += [wall(0.0, -y, 0.0, -post), wall(0.0, post, 0.0, y)]
        return Layout(np.array(boxes), (-x, -y, x, y), start, goal)


class NarrowDoorway(_Doorway):
    """Card: a pedestrian passes a doorway at the same time as the robot, which has to wait.

    Args:
        room: (min, max) m, sides of each room.
        door: (min, max) m, clear.
        speed: (min, max) m/s of the pedestrian.

    Raises:
        ValueError: If a range is not positive or not ordered, or the door does not fit.
    """

    kind = "narrow_doorway"

    def __init__(
        self,
        room: tuple[float, float] = (3.6, 4.4),
        door: tuple[float, float] = (0.9, 1.0),
        speed: tuple[float, float] = (0.5, 0.8),
    ) -> None:
        super().__init__(room, door)
        self.speed = check_range("speed", speed)

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the pedestrian, who walks on the opposite side of each room."""
        x = min(-path[0, 0], path[-1, 0])
        ends = -generator.uniform(0.4, 0.9, size=2)
        route = np.array([[x, ends[0]], [0.7, 0.0], [-0.7, 0.0], [-x, ends[1]]])
        at = float(np.abs(path[:, 0]).argmin()) / (len(path) - 1)
        return [meeting(generator, route, generator.uniform(*self.speed), path, at)]


class ObstructedDoorway(_Doorway):
    """Card: a stationary pedestrian in the doorway leaves a narrow gap for the robot.

    Args:
        room: (min, max) m, sides of each room.
        door: (min, max) m, clear.
        aside: (min, max) m from the doorway's middle to the pedestrian.

    Raises:
        ValueError: If a range is not positive or not ordered, or the door does not fit.
    """

    kind = "obstructed_doorway"

    def __init__(
        self,
        room: tuple[float, float] = (3.6, 4.4),
        door: tuple[float, float] = (1.3, 1.5),
        aside: tuple[float, float] = (0.25, 0.35),
    ) -> None:
        super().__init__(room, door)
        self.aside = check_range("aside", aside)

    def people(self, generator: np.random.Generator, path: np.ndarray) -> list[Pedestrian]:
        """Draw the stationary pedestrian on the side of the doorway that the path passes."""
        side = 1.0 if path[np.abs(path[:, 0]).argmin(), 1] >= 0 else -1.0
        y = generator.uniform(*self.aside) * side
        return [Pedestrian(np.array([[generator.uniform(-0.1, 0.1), y]]), 0.0, 0.0)]
