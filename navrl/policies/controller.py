"""Base class of controllers, with the facts that evaluations need about them."""

from __future__ import annotations

import importlib.util

from tensordict.nn import TensorDictModuleBase


class Controller(TensorDictModuleBase):
    """Base class of controllers: modules that write a normalized ``action [N, C]``.

    A controller needs no more than to be callable, so this base class is a convenience; what a
    class does not declare has the value below.

    Attributes:
        privileged: Whether it reads the true state, which no lidar measures. Tables mark it and
            never name it as the best.
        requires: Import names of optional packages; sweeps leave a controller out where one is
            missing.
        needs_known_future: Whether it reads the pedestrians' routes as their future, so that
            reactive pedestrians are refused.
    """

    privileged: bool = False
    requires: tuple[str, ...] = ()
    needs_known_future: bool = False


def is_privileged(policy: object) -> bool:
    """Return whether a policy, or its class, declares that it reads the true state."""
    return bool(getattr(policy, "privileged", False))


def missing_packages(controller: object) -> list[str]:
    """Return the packages that a controller, or its class, requires and that are not installed."""
    return [
        name
        for name in getattr(controller, "requires", ())
        if importlib.util.find_spec(name) is None
    ]
