"""Rounding of arrays to 16 bits, for recordings of many episodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from navrl import keys

_MAX_STEPS = np.iinfo(np.int16).max
_MARK = "@"  # between a name and its step
_STEPS = {
    **dict.fromkeys(
        (keys.RANGES, keys.POINTS, keys.ALIGNED_POINTS, keys.TAGD, keys.WAYPOINTS),
        2e-4,  # m
    ),
    **dict.fromkeys((keys.SPATIAL_ATTENTION, keys.TEMPORAL_ATTENTION), 5e-5),
}


def rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Replace roundable arrays by int16 multiples of a step, named ``name@step``.

    Lengths in the robot's frame are rounded to 0.1 mm, a hundredth of the lidar's noise, attention
    to 2.5e-5. An array with values beyond 16 bits is not changed.
    """
    result: dict[str, Any] = {}
    for name, value in values.items():
        step = _STEPS.get(name)
        if step is None or not (np.abs(value) <= _MAX_STEPS * step).all():
            result[name] = value
        else:
            result[f"{name}{_MARK}{step}"] = np.rint(value.astype(np.float64) / step).astype("<i2")
    return result


def restored(stored: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Invert :func:`rounded`, up to the rounding; the arrays are float32."""
    result = {}
    for name, value in stored.items():
        plain, mark, step = name.partition(_MARK)
        result[plain] = (value * float(step)).astype(np.float32) if mark else value
    return result
