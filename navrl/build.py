"""Deprecated alias of :mod:`navrl.factory` and :mod:`navrl.jobs`, for one release."""

from __future__ import annotations

import warnings
from typing import Any

from navrl import factory, jobs

_RENAMED = {"Contender": "EvaluatedPolicy", "make_contender": "make_evaluated_policy"}


def __getattr__(name: str) -> Any:
    """Return the object under its new home, with a deprecation warning.

    Raises:
        AttributeError: If neither module has it.
    """
    new = _RENAMED.get(name, name)
    for module in (factory, jobs):
        if new in module.__all__:
            message = f"navrl.build.{name} is deprecated: use {module.__name__}.{new}"
            warnings.warn(message, DeprecationWarning, stacklevel=2)
            return getattr(module, new)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
