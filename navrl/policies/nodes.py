"""Build objects from plain nodes that a stranger may have written."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

PARTS_OF_A_POLICY = ("navrl.transforms", "navrl.networks", "navrl.sim")
"""What these packages export may always be built: it computes, it opens and runs nothing else."""

_NO_PARTS = ("BatchedSimulator", "BulletSimulator", "Simulator")  # these start engines and windows


class BundleError(ValueError):
    """A folder is no usable policy bundle; the message says why."""


def reason(error: Exception) -> str:
    """Return why a file of a bundle cannot be read, without its name."""
    if isinstance(error, FileNotFoundError):
        return "no such file"
    return getattr(error, "strerror", None) or str(error)


def check_nodes(value: Any, allow: Sequence[str], place: str) -> None:
    """Hold a config to what may be built, before anything of it is.

    Args:
        value: Plain data with nodes (``_target_`` + arguments) at any depth.
        allow: Packages beside those of :data:`PARTS_OF_A_POLICY` whose targets may be built.
        place: Name of ``value`` in messages.

    Raises:
        BundleError: At the first target that is not allowed, and at an interpolation: omegaconf
            would resolve ``${oc.create:...}`` to a node that was never checked.
    """
    for where, item in walk(value, place):
        if isinstance(item, str) and "${" in item:
            raise BundleError(f"{where}={item!r}: a bundle is resolved, it has no interpolations")
        if isinstance(item, dict) and "_target_" in item:
            resolve(item["_target_"], allow, where)


def build_node(node: Any, allow: Sequence[str], place: str) -> Any:
    """Call the target of a node, those of its arguments first; ``_partial_`` keeps it uncalled.

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
    except Exception as error:  # whatever a stranger's numbers provoke
        raise BundleError(f"{place}: {type(error).__name__}: {error}") from error


def resolve(target: Any, allow: Sequence[str], place: str) -> Any:
    """Return the class or function that a target names, if it may be built.

    The name alone proves nothing (``navrl.policies.nodes.partial`` starts with ``navrl`` too), nor
    does being defined in navrl: ``navrl.policies.load_bundle`` would load another bundle with
    everything allowed. So it must be defined in, and exported by, a package of parts.

    Args:
        target: Dotted name.
        allow: Packages all of which is allowed.
        place: Where the target stands, for messages.

    Raises:
        BundleError: If it may not, or if there is no such thing.
    """
    refused = (
        f"{place}._target_={target!r}: only what {', '.join(PARTS_OF_A_POLICY)} export is built"
        f"{f', and all of {list(allow)}' if allow else ''}; allow its package if you trust it"
    )
    if not isinstance(target, str) or _package(target, (*PARTS_OF_A_POLICY, *allow)) is None:
        raise BundleError(refused)
    module_name, _, name = target.rpartition(".")
    if name in _NO_PARTS and _package(target, allow) is None:
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
    """Return the package that a dotted name lies in."""
    return next((p for p in packages if name == p or name.startswith(f"{p}.")), None)


def _is_exported_part(found: Any, home: str) -> bool:
    package = _package(home, PARTS_OF_A_POLICY)
    if package is None:
        return False
    return getattr(found, "__name__", None) in importlib.import_module(package).__all__


def walk(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Yield plain data and all that is in it, each with its dotted place."""
    yield place, value
    if isinstance(value, dict):
        for key, item in value.items():
            yield from walk(item, f"{place}.{key}")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from walk(item, f"{place}[{index}]")
