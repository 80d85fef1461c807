"""Curriculum on the number of dynamic pedestrians."""

from __future__ import annotations

from collections.abc import Sequence


class Curriculum:
    """Curriculum that raises the maximum number of dynamic pedestrians level by level.

    Args:
        levels: Maximum number of dynamic pedestrians of each level.
        threshold: Evaluation success rate above which the next level starts; levels never decrease.
        start: Index of the first level.

    Raises:
        ValueError: If levels are empty, not increasing or not positive, or the threshold is outside
            [0, 1].

    Reference:
        Paper Sec. IV-F1: N_dyn^max in {2, 4, 8}, raised when the success rate exceeds 70 %.
    """

    def __init__(
        self, levels: Sequence[int] = (2, 4, 8), threshold: float = 0.7, start: int = 0
    ) -> None:
        if not levels or any(a >= b for a, b in zip([0, *levels], levels, strict=False)):
            raise ValueError(f"levels={list(levels)}: must be positive and increasing")
        if not 0 <= threshold <= 1:
            raise ValueError(f"threshold={threshold}: must be in [0, 1]")
        if not 0 <= start < len(levels):
            raise ValueError(f"start={start}: must be in [0, {len(levels) - 1}]")
        self.levels, self.threshold, self.level = tuple(levels), threshold, start

    @property
    def max_dynamic(self) -> int:
        """Maximum number of dynamic pedestrians at the current level."""
        return self.levels[self.level]

    def report(self, success_rate: float) -> bool:
        """Process the success rate of an evaluation; return whether the level was raised."""
        rises = success_rate > self.threshold and self.level + 1 < len(self.levels)
        self.level += int(rises)
        return rises
