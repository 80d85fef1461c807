"""Long, narrow corridor with closed ends."""

from __future__ import annotations

import numpy as np

from navrl.worlds.layout import WALL_THICKNESS, Layout, check_inset, check_range, wall


class Corridor:
    """Straight corridor; start and goal in opposite corners.

    Args:
        length: (min, max) m, clear.
        width: (min, max) m, clear.
        inset: Distance of start and goal to the walls of their corners, m.

    Raises:
        ValueError: If a range is not positive or not ordered, or ``inset`` does not fit.

    Reference:
        Paper Sec. IV-F: 6 to 8 m by 2.0 to 2.5 m.
    """

    kind = "corridor"

    def __init__(
        self,
        length: tuple[float, float] = (6.0, 8.0),
        width: tuple[float, float] = (2.0, 2.5),
        inset: float = 0.5,
    ) -> None:
        self.length, self.width = check_range("length", length), check_range("width", width)
        self.inset = check_inset(inset, self.width[0] / 2)

    def layout(self, generator: np.random.Generator) -> Layout:
        """Draw a layout."""
        x, y = generator.uniform(*self.length) / 2, generator.uniform(*self.width) / 2
        corner = np.array([x - self.inset, y - self.inset])
        start = corner * generator.choice([-1.0, 1.0], size=2)
        x, y = x + WALL_THICKNESS / 2, y + WALL_THICKNESS / 2  # the walls' center lines
        boxes = np.array(
            [wall(-x, -y, x, -y), wall(-x, y, x, y), wall(-x, -y, -x, y), wall(x, -y, x, y)]
        )
        return Layout(boxes, (-x, -y, x, y), start, -start)
