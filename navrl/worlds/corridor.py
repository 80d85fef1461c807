"""A long, narrow corridor with closed ends."""

from __future__ import annotations

import numpy as np

from navrl.worlds.layout import Layout, check_range, wall


class Corridor:
    """Straight corridor; start and goal in opposite corners.

    Args:
        length: (least, most) m.
        width: (least, most) m.
        inset: m from start and goal to the walls of their corners.

    Raises:
        ValueError: If a range is not positive or not ordered.

    Reference:
        Paper Sec. IV-E: 6 to 8 m by 2.0 to 2.5 m.
    """

    kind = "corridor"

    def __init__(
        self,
        length: tuple[float, float] = (6.0, 8.0),
        width: tuple[float, float] = (2.0, 2.5),
        inset: float = 0.5,
    ) -> None:
        self.length, self.width = check_range("length", length), check_range("width", width)
        self.inset = inset

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        x, y = generator.uniform(*self.length) / 2, generator.uniform(*self.width) / 2
        boxes = np.array(
            [wall(-x, -y, x, -y), wall(-x, y, x, y), wall(-x, -y, -x, y), wall(x, -y, x, y)]
        )
        side = generator.choice([-1.0, 1.0])
        end = generator.choice([-1.0, 1.0])
        start = np.array([-end * (x - self.inset), -side * (y - self.inset)])
        return Layout(boxes, (-x, -y, x, y), start, -start)
