"""Checks of recordings from untrusted files."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from navrl import keys
from navrl.evaluation.results import OUTCOMES
from navrl.evaluation.rollout import ERROR
from navrl.sim import Contact
from navrl.untrusted import is_number
from navrl.worlds import Scenario

REPLAY = "replay"
"""Outcome of the recording of a log, in which the robot drove by other commands."""
_POSITIVE = ("time_step_s", "robot_radius", "goal_radius", "max_range")
_WITH_GAPS = (keys.PEDESTRIAN_BOXES, keys.RANGES)  # NaN: absent pedestrian, no return


def check_plain(values: Mapping[str, object]) -> None:
    """Check the texts and numbers of a recording.

    Raises:
        ValueError: If a value is not allowed; the message names the first one.
    """
    known = (*OUTCOMES, ERROR, REPLAY)
    if values["outcome"] not in known:
        shown = str(values["outcome"])[:60]
        raise ValueError(f"outcome={shown!r}: must be one of {', '.join(known)}")
    for name in _POSITIVE:
        if not is_number(values[name], 1e-6, 1e6):
            raise ValueError(f"{name}={str(values[name])[:60]!r}: must be a positive number")
    contact = values.get("contact")
    if contact is not None and contact not in set(Contact):
        raise ValueError(f"contact={contact!r}: must be one of {[int(code) for code in Contact]}")
    if not isinstance(values["scenario"], str):
        raise ValueError("scenario: must be text")
    Scenario.from_json(values["scenario"])


def check_finite(values: Mapping[str, object]) -> None:
    """Check that the arrays of a recording are finite, except NaN for absent values.

    Raises:
        ValueError: If a value is not allowed; the message names the first one.
    """
    for name, array in values.items():
        if not isinstance(array, np.ndarray):
            continue
        if array.dtype.kind not in "biuf":
            raise ValueError(f"{name}: must hold numbers, has type {array.dtype}")
        if name not in _WITH_GAPS and not np.isfinite(array).all():
            raise ValueError(f"{name}: must be finite")


def check_shape(name: str, array: np.ndarray, expected: tuple[int | None, ...]) -> None:
    """Check the shape of an array; ``None`` is any size.

    Raises:
        ValueError: If the shape differs; the message names the array.
    """
    got = np.shape(array)
    fits = len(got) == len(expected) and all(
        want is None or want == have for want, have in zip(expected, got, strict=True)
    )
    if not fits:
        raise ValueError(f"{name}.shape={list(got)}: must be {list(expected)}")
