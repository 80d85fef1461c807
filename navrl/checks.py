"""Checks of arguments that several constructors share."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Sequence
from numbers import Integral
from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike

_POSE = "three finite numbers (x, y, yaw)"
_MAX_ANGLE = 2.0 * math.pi + 1e-3  # rad, rounded values too; one in degrees soon exceeds it


def check_positive(**values: float) -> None:
    """Check that arguments are positive and finite.

    Args:
        values: Arguments by name.

    Raises:
        ValueError: If an argument is not; the message names the first one.
    """
    for name, value in values.items():
        if not (is_finite(value) and value > 0.0):
            raise ValueError(f"{name}={value!r}: must be positive and finite")


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


def is_finite(value: object) -> TypeGuard[float]:
    """Return whether a value is a finite number; text and ``None`` are not.

    Example:
        >>> is_finite(1), is_finite(math.inf), is_finite("1"), is_finite(None)
        (True, False, False, False)
    """
    try:
        return math.isfinite(value)  # pyright: ignore[reportArgumentType] -- what is asked
    except (TypeError, ValueError, OverflowError):
        return False


def is_real(value: object) -> TypeGuard[float]:
    """Return whether a value is a number or infinite; NaN, text and ``None`` are not.

    Example:
        >>> is_real(math.inf), is_real(math.nan), is_real("1")
        (True, False, False)
    """
    try:
        return not math.isnan(value)  # pyright: ignore[reportArgumentType] -- what is asked
    except (TypeError, ValueError, OverflowError):
        return False


def check_angles(**values: float) -> None:
    """Check that angles are in rad: finite, and within a full circle to either side.

    Args:
        values: Angles by name, rad.

    Raises:
        ValueError: If an angle is not; the message names the first one.
    """
    for name, value in values.items():
        if not is_finite(value):
            raise ValueError(f"{name}={value!r}: must be finite (rad)")
        if abs(value) > _MAX_ANGLE:
            raise ValueError(f"{name}={value:g}: must be in rad, in [-2 pi, 2 pi]")


def checked_numbers(name: str, values: ArrayLike | None, allowed: str) -> np.ndarray:
    """Return values as float64, of any shape.

    Args:
        name: Name of the argument.
        values: Numbers.
        allowed: What they must be, for the message, e.g. ``"[beams] numbers (m)"``.

    Raises:
        ValueError: If they are not numbers, e.g. text or ``None``, or not an array.
    """
    try:
        with np.errstate(over="ignore"):
            found = np.asarray(values)
            if found.dtype.kind in "biuf":
                return found.astype(np.float64)
    except ValueError:
        pass  # rows of different lengths
    shown = " ".join(reprlib.repr(values).split())
    raise ValueError(f"{name}={shown}: must be {allowed}")


def checked_pose(name: str, pose: ArrayLike | None) -> np.ndarray:
    """Return a pose or mount as ``[3]`` float64 (x, y, yaw), m and rad.

    Args:
        name: Name of the argument.
        pose: (x, y, yaw), m and rad.

    Raises:
        ValueError: If it is not three finite numbers, or if the yaw is beyond a full circle to
            either side, as one in degrees is.
    """
    values = checked_numbers(name, pose, _POSE)
    check_pose(name, values.tolist())
    return values


def check_pose(name: str, pose: Sequence[float]) -> None:
    """Check (x, y, yaw) as :func:`checked_pose`, without numpy: for code that torch compiles.

    Args:
        name: Name of the argument.
        pose: (x, y, yaw), m and rad.

    Raises:
        ValueError: If it is not such a pose.
    """
    if not (hasattr(pose, "__len__") and len(pose) == 3 and all(is_finite(p) for p in pose)):
        raise ValueError(f"{name}={pose!r}: must be {_POSE}")
    if abs(pose[2]) > _MAX_ANGLE:
        raise ValueError(
            f"{name}={[*pose]}: yaw={pose[2]:g}: must be in rad, wrapped to [-2 pi, 2 pi]"
        )
