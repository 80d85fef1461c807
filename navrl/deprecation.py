"""Aliases of deprecated names, which warn.

Names in code cause a :class:`DeprecationWarning`, which Python shows to developers. Configuration
keys cause a :class:`FutureWarning`, which it shows to everyone.
"""

from __future__ import annotations

import functools
import inspect
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from enum import EnumType
from importlib import import_module
from typing import Any

RENAMED_KEYS = {
    "least_speed": "min_descriptor_speed",
    "most_speed": "max_descriptor_speed",
    "greed": "heuristic_weight",
}
"""Configuration keys of version 0.1, anywhere in a node of a policy, and their present names."""

RENAMED_GROUPS = {"behaviour": "behavior"}
"""Configuration groups of version 0.1, and their present names."""

RENAMED_INPUTS = {
    "waypoint": "waypoints_scaled",
    "distance": "ranges_pooled_scaled",
    "distance_previous": "ranges_previous_scaled",
    "distance_earlier": "ranges_earlier_scaled",
    "distances": "ranges_history_scaled",
    "goal": "goal_position_scaled",
}
"""Keys of network inputs of version 0.1, and their present names."""


def warn(
    old: str, advice: str, stacklevel: int = 3, category: type[Warning] = DeprecationWarning
) -> None:
    """Warn that a name is deprecated.

    Args:
        old: The deprecated name.
        advice: What to do instead.
        stacklevel: Number of stack frames from here to the code that used the name.
        category: Kind of warning.
    """
    message = f"{old} is deprecated: {advice}"
    warnings.warn(message, category, stacklevel=stacklevel)


def renamed_attributes(
    module: str, names: Mapping[str, str], fallback: Callable[[str], Any] | None = None
) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` that resolves renamed attributes.

    Args:
        module: Name of the module.
        names: New name by old name; a name of another module is preceded by that module's.
        fallback: Called with other names.

    Example:
        >>> resolve = renamed_attributes("math", {"archimedes": "pi"})
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     resolve("archimedes")
        3.141592653589793
    """

    def resolve(name: str) -> Any:
        if name in names:
            home, _, new = names[name].rpartition(".")
            warn(f"{module}.{name}", f"use {home or module}.{new}")
            return getattr(import_module(home or module), new)
        if fallback is not None:
            return fallback(name)
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return resolve


def renamed_arguments(**names: str | None) -> Callable[[Callable], Callable]:
    """Decorate a function so that it accepts deprecated names of keyword arguments.

    Args:
        names: New name by old name; ``None`` ignores the argument.

    Example:
        >>> @renamed_arguments(long="length")
        ... def double(length):
        ...     return 2 * length
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     double(long=3)
        6
    """

    def decorate(function: Callable) -> Callable:
        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            for old in names.keys() & kwargs.keys():
                new, value = names[old], kwargs.pop(old)
                shown = function.__qualname__.removesuffix(".__init__")
                if new is None:
                    warn(f"{shown}: {old}", "it has no effect; remove it")
                elif new in kwargs:
                    raise TypeError(f"{shown}: {old} and {new}: must be given once, as {new}")
                else:
                    warn(f"{shown}: {old}", f"use {new}")
                    kwargs[new] = value
            return function(*args, **kwargs)

        return call

    return decorate


def taken_argument(function: Callable, name: str) -> str:
    """Return the name under which a user's class or function takes an argument.

    Args:
        function: Class or function written for this version or for 0.1.
        name: Present name of the argument.

    Example:
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     taken_argument(lambda make_env, behaviour: None, "behavior")
        'behaviour'
    """
    taken = inspect.signature(function).parameters
    for old, new in RENAMED_GROUPS.items():
        if new == name and old in taken and new not in taken:
            warn(f"{function.__qualname__}: {old}", f"call it {new}")
            return old
    return name


def renamed_keys(node: Any, is_silent: bool = False) -> Any:
    """Return a copy of a configuration node with the present names of its keys.

    Args:
        node: Plain data; lists and mappings are copied.
        is_silent: Whether to rename without a warning, for files that navrl wrote.

    Example:
        >>> renamed_keys({"shield": {"least_speed": 0.3}}, is_silent=True)
        {'shield': {'min_descriptor_speed': 0.3}}
    """
    if isinstance(node, list):
        return [renamed_keys(item, is_silent) for item in node]
    if not isinstance(node, Mapping):
        return node
    for old in () if is_silent else RENAMED_KEYS.keys() & node.keys():
        warn(f"config key {old}", f"use {RENAMED_KEYS[old]}", category=FutureWarning)
    return {
        RENAMED_KEYS.get(name, name): renamed_keys(value, is_silent) for name, value in node.items()
    }


def present_key(key: str) -> str:
    """Return a dotted configuration key with the present names of its parts.

    Example:
        >>> present_key("efforts.0.greed")
        'efforts.0.heuristic_weight'
    """
    return ".".join(RENAMED_KEYS.get(part, part) for part in key.split("."))


def input_key(key: str, observed: Collection[str]) -> str:
    """Return the name under which a network input is observed, in this version or in 0.1.

    Args:
        key: Key that a network reads.
        observed: All observed keys.

    Returns:
        ``key`` itself if it is observed, or under neither name. A bundle of version 0.1 has the
        old names.

    Example:
        >>> input_key("waypoints_scaled", ["spatial", "waypoint"])
        'waypoint'
    """
    if key in observed:
        return key
    present = RENAMED_INPUTS.get(key)
    if present is not None and present in observed:
        warn(f"input key {key}", f"use {present}")
        return present
    return next((old for old, new in RENAMED_INPUTS.items() if new == key and old in observed), key)


def former_input(needed: Iterable[str], observed: Collection[str]) -> str | None:
    """Return a message on the first missing network input that has its name of version 0.1.

    Args:
        needed: Keys that a network reads.
        observed: Keys of its input.

    Returns:
        ``None`` if no missing key is observed under its former name.

    Example:
        >>> former_input(["spatial", "waypoints_scaled"], ["spatial", "waypoint"])
        'waypoints_scaled: missing; waypoint is its name of version 0.1: rename it'
    """
    for old, new in RENAMED_INPUTS.items():
        if new in needed and new not in observed and old in observed:
            return f"{new}: missing; {old} is its name of version 0.1: rename it"
    return None


def renamed_inputs(node: Any) -> Any:
    """Return a copy of a bundle's configuration with the present names of network inputs.

    Args:
        node: Plain data. Names are replaced in ``in_keys``, ``out_keys``, ``in_key``,
            ``context_key`` and ``shapes``.

    Example:
        >>> renamed_inputs({"in_keys": ["points", "waypoint"], "waypoint": 1})
        {'in_keys': ['points', 'waypoints_scaled'], 'waypoint': 1}
    """
    if isinstance(node, list):
        return [renamed_inputs(item) for item in node]
    if not isinstance(node, Mapping):
        return node
    return {name: _renamed_input(name, renamed_inputs(value)) for name, value in node.items()}


def _renamed_input(name: str, value: Any) -> Any:
    def present(key: Any) -> Any:
        return RENAMED_INPUTS.get(key, key) if isinstance(key, str) else key

    if name in ("in_keys", "out_keys") and isinstance(value, list):
        return [present(key) for key in value]
    if name in ("in_key", "context_key"):
        return present(value)
    if name == "shapes" and isinstance(value, Mapping):
        return {present(key): shape for key, shape in value.items()}
    return value


class RenamedMembers(EnumType):
    """Metaclass of enumerations with renamed members."""

    def __getattr__(cls, name: str) -> Any:
        """Return the member that replaces ``name``."""
        if (cls.__name__, name) not in _MEMBERS:
            raise AttributeError(f"type object {cls.__name__!r} has no attribute {name!r}")
        return cls._renamed(name, stacklevel=4)

    def __getitem__(cls, name: str) -> Any:
        """Return the member of this name, or the one that replaces it."""
        if (cls.__name__, name) not in _MEMBERS:
            return super().__getitem__(name)
        return cls._renamed(name, stacklevel=4)

    def _renamed(cls, name: str, stacklevel: int) -> Any:
        new = _MEMBERS[cls.__name__, name]
        warn(f"{cls.__name__}.{name}", f"use {cls.__name__}.{new}", stacklevel)
        return cls[new]


_MEMBERS = {("Contact", "RUN_INTO"): "HIT_BY_PEDESTRIAN"}
