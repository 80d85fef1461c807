"""Parameters of which a few run by day: they find most of the faults that all find at night."""

from collections.abc import Iterable

import pytest


def mostly(values: Iterable, by_day: Iterable) -> list:
    """Return the values, or tuples of values, as parameters; those not in ``by_day`` are slow."""
    values, by_day = list(values), list(by_day)
    assert all(value in values for value in by_day), by_day
    return [
        value if value in by_day else pytest.param(*several(value), marks=pytest.mark.slow)
        for value in values
    ]


def several(value: object) -> tuple:
    return value if isinstance(value, tuple) else (value,)
