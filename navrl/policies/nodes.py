"""Safe construction of objects from untrusted configuration nodes."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

POLICY_PACKAGES = ("navrl.transforms", "navrl.networks", "navrl.sim", "navrl.ops.scanner")
"""Packages and modules whose exports may always be built: they only compute."""

_FORBIDDEN_PARTS = (
    "BatchedSimulator",
    "BulletSimulator",
    "Simulator",
)  # they start engines and windows


class BundleError(ValueError):
    """Error for a folder that is not a usable policy bundle."""


def reason(error: Exception) -> str:
    """Return the reason why a file of a bundle cannot be read, without its name."""
    if isinstance(error, FileNotFoundError):
        return "no such file"
    return getattr(error, "strerror", None) or str(error)


def check_nodes(value: Any, allow: Sequence[str], place: str) -> None:
    """Check that all targets of a config may be built, before building it.

    Args:
        value: Plain data with nodes (``_target_`` + arguments) at any depth.
        allow: Additional packages to :data:`POLICY_PACKAGES` whose targets may be built.
        place: Name of ``value`` in messages.

    Raises:
        BundleError: If a target is not allowed, or if there is an interpolation: omegaconf would
            resolve ``${oc.create:...}`` to an unchecked node.
    """
    for where, item in walk(value, place):
        if isinstance(item, str) and "${" in item:
            raise BundleError(f"{where}={item!r}: must not be an interpolation in a bundle")
        if isinstance(item, dict) and "_target_" in item:
            resolve(item["_target_"], allow, where)


def build_node(node: Any, allow: Sequence[str], place: str) -> Any:
    """Build a node and the nodes in its arguments; ``_partial_`` returns a partial function.

    Raises:
        BundleError: If a target is not allowed or does not take its arguments.
    """
    if isinstance(node, list):
        return [build_node(item, allow, f"{place}[{i}]") for i, item in enumerate(node)]
    if not isinstance(node, dict):
        return node
    built = {key: build_node(item, allow, f"{place}.{key}") for key, item in node.items()}
    if "_target_" not in built:
        return built
    make = resolve(built.pop("_target_"), allow, place)
    if built.pop("_partial_", False):
        return partial(make, **built)
    try:
        return make(**built)
    except Exception as error:  # untrusted values can cause any error
        raise BundleError(f"{place}: {type(error).__name__}: {error}") from error


def resolve(target: Any, allow: Sequence[str], place: str) -> Any:
    """Return the class or function of a target, if it may be built.

    Neither the name (``navrl.policies.nodes.partial`` also starts with ``navrl``) nor a definition
    in navrl is sufficient: ``navrl.policies.load_bundle`` would load another bundle without checks.
    So a target must be defined in, and exported by, one of the allowed packages.

    Args:
        target: Dotted name.
        allow: Packages without restriction.
        place: Name of the node in messages.

    Raises:
        BundleError: If it may not be built or does not exist.
    """
    refused = (
        f"{place}._target_={target!r}: must be exported by {', '.join(POLICY_PACKAGES)}"
        f"{f', or be in {list(allow)}' if allow else ''}; allow its package if you trust it"
    )
    if not isinstance(target, str) or _package(target, (*POLICY_PACKAGES, *allow)) is None:
        raise BundleError(refused)
    module_name, _, name = target.rpartition(".")
    if name in _FORBIDDEN_PARTS and _package(target, allow) is None:
        raise BundleError(refused)
    try:
        found = getattr(importlib.import_module(module_name), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise BundleError(f"{place}._target_={target!r}: {error}") from error
    home = getattr(found, "__module__", None) or ""
    if not callable(found) or not (_package(home, allow) or _is_exported_part(found, home)):
        raise BundleError(refused)
    return found


def _package(name: str, packages: Sequence[str]) -> str | None:
    """Return the package that contains a dotted name, or ``None``."""
    return next((p for p in packages if name == p or name.startswith(f"{p}.")), None)


def _is_exported_part(found: Any, home: str) -> bool:
    package = _package(home, POLICY_PACKAGES)
    if package is None:
        return False
    return getattr(found, "__name__", None) in importlib.import_module(package).__all__


def walk(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Yield plain data and all nested values, each with its dotted name."""
    yield place, value
    if isinstance(value, dict):
        for key, item in value.items():
            yield from walk(item, f"{place}.{key}")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from walk(item, f"{place}[{index}]")
