"""Policies from a class or function of a Python module."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable
from typing import Any, cast

from tensordict import TensorDictBase

from navrl.sim import RobotModel

Policy = Callable[[TensorDictBase], TensorDictBase]


def load_policy(reference: str, robot: RobotModel, **arguments: Any) -> Policy:
    """Return the policy that a reference names; imports, and so runs, its module.

    Args:
        reference: ``MODULE:NAME`` of a function from TensorDict to TensorDict, or of a class of
            such callables, e.g. a :class:`navrl.policies.Controller`.
        robot: Passed to a class that has an argument of this name.
        **arguments: Further arguments of a class.

    Returns:
        The function, or an object of the class. It writes ``action [N, C]`` in [-1, 1].

    Raises:
        ValueError: If there is no such name, it is not callable, or arguments do not fit.
    """
    module, _, name = reference.partition(":")
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ValueError(
            f"policy={reference}: {error}; PYTHONPATH=. finds modules in the current folder"
        ) from error
    if not callable(found):
        raise ValueError(f"policy={reference}: must be a class or function, got {found!r:.60}")
    if not inspect.isclass(found):
        if arguments:
            raise ValueError(f"policy={reference}: a function has no arguments, got {arguments}")
        return cast(Policy, found)
    parameters = inspect.signature(found).parameters
    known = {"robot": robot} if "robot" in parameters else {}
    try:
        built = found(**known, **arguments)
    except TypeError as error:
        allowed = ", ".join(name for name in parameters if name != "robot")
        raise ValueError(
            f"policy={reference}: {error}; +change.controller.NAME=VALUE sets {allowed or 'none'}"
        ) from error
    if not callable(built):
        raise ValueError(f"policy={reference}: its objects must be callable")
    return cast(Policy, built)
