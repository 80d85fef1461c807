"""Deprecated names of configuration groups, in overrides and in stored configurations."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from navrl.deprecation import RENAMED_GROUPS, RENAMED_KEYS, warn


def renamed_overrides(words: Iterable[str]) -> list[str]:
    """Return the words of a command line with the present names of configuration groups.

    Args:
        words: Hydra overrides and options.

    Example:
        >>> import warnings
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore")
        ...     renamed_overrides(["behaviour=paper", "++behaviour.random_frames=0", "seed=1"])
        ['behavior=paper', '++behavior.random_frames=0', 'seed=1']
    """
    return [_renamed_override(word) for word in words]


def _renamed_override(word: str) -> str:
    """Return an override with the present names of its group and of a part's key."""
    keys = "|".join(RENAMED_KEYS)
    key = re.match(rf"((?:\+\+)?(?:transforms|deployment)\.(?:\w+\.)*)({keys})=", word)
    if key is not None:
        old, new = key[2], RENAMED_KEYS[key[2]]
        warn(f"config key {old}", f"use {new}", stacklevel=5, category=FutureWarning)
        return f"{key[1]}{new}{word[key.end(2) :]}"
    groups = "|".join(RENAMED_GROUPS)
    match = re.match(rf"([+]*|~)({groups})([.@][^=]*)?(=|$)", word)
    if match is None or (match[4] != "=" and match[1] != "~"):
        return word  # another override, or a word that belongs to an option
    old, new = match[2], RENAMED_GROUPS[match[2]]
    warn(f"config group {old}", f"use {new}", stacklevel=5, category=FutureWarning)
    return f"{match[1]}{new}{word[match.end(2) :]}"


def renamed_groups(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return a stored configuration with the present names of its groups, without a warning.

    Args:
        config: Configuration of a run, as plain data.

    Example:
        >>> renamed_groups({"behaviour": {"_target_": "navrl.training.Behaviour"}, "seed": 0})
        {'behavior': {'_target_': 'navrl.training.Behavior'}, 'seed': 0}
    """
    renamed = {RENAMED_GROUPS.get(name, name): value for name, value in config.items()}
    target = "navrl.training.Behaviour"
    for node in renamed.values():
        if isinstance(node, dict) and node.get("_target_") == target:
            node["_target_"] = "navrl.training.Behavior"
    return renamed


def check_groups(config: Mapping[Any, Any]) -> None:
    """Check that a composed configuration has no group under a deprecated name.

    Args:
        config: Composed configuration; a file of the user may have added the group.

    Raises:
        ValueError: If it has one.
    """
    for old, new in RENAMED_GROUPS.items():
        if old in config:
            raise ValueError(f"{old}: must be {new}, the present name of this configuration group")
