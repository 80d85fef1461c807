"""Checks of arguments that several constructors share."""

from __future__ import annotations

from numbers import Integral


def check_positive(**values: float) -> None:
    """Check that arguments are positive and finite.

    Args:
        values: Arguments by name.

    Raises:
        ValueError: If an argument is not; the message names the first one.
    """
    for name, value in values.items():
        if not 0.0 < value < float("inf"):
            raise ValueError(f"{name}={value}: must be positive and finite")


def check_counts(**values: int | None) -> None:
    """Check that arguments are integers of at least 1.

    Args:
        values: Arguments by name; ``None`` is not checked.

    Raises:
        ValueError: If an argument is not; the message names the first one.
    """
    for name, value in values.items():
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
            raise ValueError(f"{name}={value!r}: must be an integer, at least 1")
