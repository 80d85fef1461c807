"""Metric with all facts that files, comparisons, pictures and docs need."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from navrl.evaluation.metrics.trajectory import Trajectory

BETTER = ("higher", "lower", "")
OVER = ("episodes", "successes")
_NAME = re.compile(r"[A-Za-z][\w.]{0,59}")
_UNIT = re.compile(r"[\w/^%.-]{1,20}")
_COLOR = re.compile(r"(#[0-9A-Fa-f]{6})?")


@dataclass(frozen=True)
class Metric:
    """Function of trajectories with a name, a unit and rules of comparison.

    Args:
        name: Column of ``episodes.csv``.
        unit: SI; ``1`` of a share or of 0 and 1.
        function: Maps E episodes to ``[E]`` numbers; NaN where it is not defined.
        better: ``higher`` or ``lower``; empty where neither is.
        compared: Whether ``navrl-compare`` and reports list it.
        over: ``successes`` of what grows with an episode's length, so that comparisons need a
            reached goal; ``episodes`` of anything else.
        label: Label of the outcome that the metric marks, for tables and pictures; else empty.
        color: ``#RRGGBB`` of that ending.
        is_rate: Whether it is 0 or 1 in each episode.
        of_error: Value of an episode that raised; ``None`` if it is not defined then. 0 of a rate.

    Raises:
        ValueError: If a value is not allowed.

    Example:
        >>> from navrl.evaluation.metrics import Metric
        >>> steps = Metric("steps", "1", lambda trajectory: 1.0 * trajectory.num_steps, "lower")
        >>> steps.over
        'episodes'
    """

    name: str
    unit: str
    function: Callable[[Trajectory], np.ndarray]
    better: str = ""
    compared: bool = False
    over: str = "episodes"
    label: str = ""
    color: str = ""
    is_rate: bool = False
    of_error: float | None = None

    def __post_init__(self) -> None:
        allowed = {
            "name": (_NAME, "a letter, then at most 59 letters, digits, '_' or '.'"),
            "unit": (_UNIT, "1 to 20 letters, digits or any of / ^ % . -"),
            "color": (_COLOR, "#RRGGBB or empty"),
        }
        for key, (pattern, what) in allowed.items():
            value = getattr(self, key)
            if not isinstance(value, str) or not pattern.fullmatch(value):
                raise ValueError(f"{key}={str(value)[:60]!r}: must be {what}")
        for key, choices in {"better": BETTER, "over": OVER}.items():
            if getattr(self, key) not in choices:
                value = str(getattr(self, key))[:60]
                raise ValueError(f"{key}={value!r}: must be one of {', '.join(map(repr, choices))}")
        if not callable(self.function):
            raise ValueError(f"function={self.function!r}: must be callable")
        if self.is_rate and self.of_error is None:
            object.__setattr__(self, "of_error", 0.0)

    @property
    def is_ending(self) -> bool:
        """Return whether the metric marks an ending of episodes, with a label and a color."""
        return bool(self.color)

    @property
    def definition(self) -> str:
        """The function's first sentence, without the shape that it returns."""
        first = _plain((inspect.getdoc(self.function) or "").partition("\n\n")[0])
        return re.sub(rf"^Return `\[E\]`,? ?({re.escape(self.unit)},? |in \[0, 1\], )?", "", first)

    @property
    def source(self) -> str:
        """The function's ``Reference`` section in one line; empty without one."""
        text = inspect.getdoc(self.function) or ""
        found = re.search(r"Reference:\n((?: {4}.*\n?)+)", text)
        return _plain(found[1]) if found else ""

    def values(self, trajectory: Trajectory) -> np.ndarray:
        """Return the metric ``[E]`` of E episodes.

        Raises:
            ValueError: If the function returned another shape.
        """
        values = np.asarray(self.function(trajectory))
        if values.shape != (len(trajectory),):
            raise ValueError(
                f"metric {self.name}: must return {[len(trajectory)]} numbers, one an episode, "
                f"got shape {list(values.shape)}"
            )
        return values

    def facts(self) -> dict[str, object]:
        """Return what a reader of files needs who does not have the function."""
        names = ("unit", "better", "compared", "over", "is_rate", "of_error")
        return {name: getattr(self, name) for name in names}

    @classmethod
    def from_facts(cls, name: str, facts: Mapping[str, Any]) -> Metric:
        """Rebuild from :meth:`facts`, without the function; more keys are ignored.

        Raises:
            ValueError: If a value is not allowed or missing.
        """
        known = ("unit", "better", "compared", "over", "is_rate", "of_error")
        missing = [key for key in known if key not in facts]
        if missing:
            raise ValueError(f"keys {missing} are missing")
        flags = {key: facts[key] for key in ("compared", "is_rate")}
        for key, value in flags.items():
            if not isinstance(value, bool):
                raise ValueError(f"{key}={str(value)[:60]!r}: must be true or false")
        of_error = facts["of_error"]
        if of_error is not None and type(of_error) not in (int, float):
            raise ValueError(f"of_error={str(of_error)[:60]!r}: must be a number or null")
        return cls(name, function=_unknown, **{key: facts[key] for key in known})


def _plain(text: str) -> str:
    """Return a part of a docstring in one line of Markdown without its full stop."""
    text = re.sub(r":\w+:(?=`)", "", " ".join(text.split()))
    return text.replace("``", "`").replace("*", r"\*").removesuffix(".")


def _unknown(trajectory: Trajectory) -> np.ndarray:
    """Raise an error: the metric was read from a file and has no function."""
    raise NotImplementedError("this metric was read from a file, which does not hold its function")
