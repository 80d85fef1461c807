"""Parameters of which most run every night only, because the others would find the same faults."""

from collections.abc import Iterable

import pytest


def mostly(values: Iterable, by_day: Iterable) -> list:
    """Return the values, or tuples of values, as parameters; those not in ``by_day`` are slow."""
    by_day = list(by_day)
    return [
        value if value in by_day else pytest.param(*several(value), marks=pytest.mark.slow)
        for value in values
    ]


def several(value: object) -> tuple:
    return value if isinstance(value, tuple) else (value,)
