"""Intersection of two hallways with blind corners."""

from __future__ import annotations

import numpy as np

from navrl.worlds.layout import WALL_THICKNESS, Layout, check_inset, check_range, wall


class Intersection:
    """Cross-shaped hallways; start and goal at the ends of different arms.

    Args:
        width: (min, max) m of each hallway, clear.
        arm: (min, max) m from the center to an arm's end.
        inset: Distance of start and goal to the end of their arm, m.

    Raises:
        ValueError: If a range is not positive or not ordered, ``inset`` does not fit, or an arm may
            end inside the intersection.

    Reference:
        Paper Sec. IV-F: hallways 2.0 to 2.5 m wide; arms of 3 to 5 m as in the authors' precursor.
    """

    kind = "intersection"

    def __init__(
        self,
        width: tuple[float, float] = (2.0, 2.5),
        arm: tuple[float, float] = (3.0, 5.0),
        inset: float = 0.5,
    ) -> None:
        self.width, self.arm = check_range("width", width), check_range("arm", arm)
        self.inset = check_inset(inset, self.width[0] / 2)
        if self.arm[0] < self.width[1] / 2 + 2 * self.inset:
            raise ValueError(
                f"arm={list(arm)}: must be >= width/2 + 2 inset = "
                f"{self.width[1] / 2 + 2 * self.inset:.3g} m"
            )

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        half = generator.uniform(*self.width, size=2) / 2  # of the hallway along x, along y
        reach = generator.uniform(*self.arm, size=4)  # east, north, west, south
        ends = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
        ends *= (reach - self.inset)[:, None]
        # Anywhere across the hallway, at least the inset away from its walls.
        across = generator.uniform(-1.0, 1.0, size=4) * (half[[0, 1, 0, 1]] - self.inset)
        ends[[0, 2], 1], ends[[1, 3], 0] = across[[0, 2]], across[[1, 3]]
        first, second = generator.choice(4, size=2, replace=False)
        half, reach = half + WALL_THICKNESS / 2, reach + WALL_THICKNESS / 2  # center lines
        east, north, west, south = reach
        extent = (-west, -south, east, north)
        return Layout(_walls(half[1], half[0], extent), extent, ends[first], ends[second])


def _walls(hx: float, hy: float, extent: tuple[float, float, float, float]) -> np.ndarray:
    """Return three walls per arm, around an intersection with half sides ``hx``, ``hy``."""
    west, south, east, north = extent
    boxes = []
    for end in (east, west):
        corner = np.sign(end) * hx
        boxes += [wall(corner, side * hy, end, side * hy) for side in (-1, 1)]
        boxes.append(wall(end, -hy, end, hy))
    for end in (north, south):
        corner = np.sign(end) * hy
        boxes += [wall(side * hx, corner, side * hx, end) for side in (-1, 1)]
        boxes.append(wall(-hx, end, hx, end))
    return np.array(boxes)
