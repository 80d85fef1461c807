"""A crossing of two hallways with blind corners."""

from __future__ import annotations

import numpy as np

from navrl.worlds.layout import Layout, check_range, wall


class Intersection:
    """Cross-shaped hallways; start and goal in the dead ends of different arms.

    Args:
        width: (least, most) m of each hallway.
        arm: (least, most) m from the centre to an arm's end.
        inset: m from start and goal to the end of their arm.

    Raises:
        ValueError: If a range is not positive or not ordered.

    Reference:
        Paper Sec. IV-E: hallways 2.0 to 2.5 m wide; arms of 3 to 5 m as in the authors' precursor.
    """

    kind = "intersection"

    def __init__(
        self,
        width: tuple[float, float] = (2.0, 2.5),
        arm: tuple[float, float] = (3.0, 5.0),
        inset: float = 0.5,
    ) -> None:
        self.width, self.arm = check_range("width", width), check_range("arm", arm)
        self.inset = inset

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        half = generator.uniform(*self.width, size=2) / 2  # of the hallway along x, along y
        east, north, west, south = generator.uniform(*self.arm, size=4)
        hx, hy = half[1], half[0]
        boxes = []
        for end in (east, -west):
            corner = np.sign(end) * hx
            boxes += [wall(corner, side * hy, end, side * hy) for side in (-1, 1)]
            boxes.append(wall(end, -hy, end, hy))
        for end in (north, -south):
            corner = np.sign(end) * hy
            boxes += [wall(side * hx, corner, side * hx, end) for side in (-1, 1)]
            boxes.append(wall(-hx, end, hx, end))
        ends = np.array([[east, 0.0], [0.0, north], [-west, 0.0], [0.0, -south]])
        reach = np.array([east, north, west, south])[:, None]
        ends *= (reach - self.inset) / reach
        # Anywhere across the hallway, but not nearer to its walls than the inset.
        across = generator.uniform(-1.0, 1.0, size=4) * (half[[0, 1, 0, 1]] - self.inset)
        ends[[0, 2], 1], ends[[1, 3], 0] = across[[0, 2]], across[[1, 3]]
        first, second = generator.choice(4, size=2, replace=False)
        return Layout(np.array(boxes), (-west, -south, east, north), ends[first], ends[second])
