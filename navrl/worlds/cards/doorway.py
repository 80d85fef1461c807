"""Cards of two rooms joined by a doorway."""

from __future__ import annotations

import numpy as np

from navrl.worlds.cards.card import meeting
from navrl.worlds.layout import WALL_THICKNESS, Layout, check_range, wall
from navrl.worlds.scenario import Pedestrian


class _Doorway:
    """Two rooms side by side; the doorway is at the origin, start left and goal right of it."""

    def __init__(self, room: tuple[float, float], door: tuple[float, float]) -> None:
        self.room, self.door = check_range("room", room), check_range("door", door)
        if not 0.8 <= self.door[0] <= self.door[1] <= self.room[0] - 2.0:
            raise ValueError(
                f"door={list(door)}: need 0.8 <= door <= room - 2 = {self.room[0] - 2.0:.3g} m"
            )

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        half = generator.uniform(*self.room) / 2  # of each room's sides
        half_door = generator.uniform(*self.door) / 2
        start = np.array([-2 * half + 0.6, generator.uniform(0.3, half - 0.7)])
        goal = np.array([2 * half - 0.6, generator.uniform(0.3, half - 0.7)])
        x, y = 2 * half + WALL_THICKNESS / 2, half + WALL_THICKNESS / 2  # the walls' centre lines
        post = half_door + WALL_THICKNESS / 2
        boxes = [wall(-x, -y, x, -y), wall(-x, y, x, y), wall(-x, -y, -x, y), wall(x, -y, x, y)]
        boxes += [wall(0.0, -y, 0.0, -post), wall(0.0, post, 0.0, y)]
        return Layout(np.array(boxes), (-x, -y, x, y), start, goal)


class NarrowDoorway(_Doorway):
    """Somebody comes through a doorway just as the robot wants to: one of them has to wait.

    Args:
        room: (least, most) m, sides of each room.
        door: (least, most) m, clear.
        speed: (least, most) m/s of the pedestrian.

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
        """Draw who is met: they come and go on the other side of each room than the robot."""
        x = min(-path[0, 0], path[-1, 0])
        ends = -generator.uniform(0.4, 0.9, size=2)
        route = np.array([[x, ends[0]], [0.7, 0.0], [-0.7, 0.0], [-x, ends[1]]])
        at = float(np.abs(path[:, 0]).argmin()) / (len(path) - 1)
        return [meeting(generator, route, generator.uniform(*self.speed), path, at)]


class ObstructedDoorway(_Doorway):
    """Somebody stands in the doorway and leaves the robot just enough room beside them.

    Args:
        room: (least, most) m, sides of each room.
        door: (least, most) m, clear.
        aside: (least, most) m from the doorway's middle to who stands there.

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
        """Draw who stands in the way: on the side of the doorway that the path takes."""
        side = 1.0 if path[np.abs(path[:, 0]).argmin(), 1] >= 0 else -1.0
        y = generator.uniform(*self.aside) * side
        return [Pedestrian(np.array([[generator.uniform(-0.1, 0.1), y]]), 0.0, 0.0)]
