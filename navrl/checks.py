"""Checks of arguments that several constructors share."""

from __future__ import annotations


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
