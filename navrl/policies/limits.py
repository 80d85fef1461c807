"""Bounds on a bundle's numbers: loading a stranger's bundle allocates what its files hold.

A network is first built without memory and compared with the shapes that the weights' file lists,
so its size is bounded by that file. All other sizes are bounded by their names, and products of
them by the transforms that allocate them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from navrl.policies.nodes import BundleError, build_node, reason, walk

_MAX_NUMBER = 100_000  # of any whole number: a layer's units
_MAX_TEXT = 1_000  # characters of any text: keys and names
_MAX_DEPTH = 50  # of nodes in nodes; those of the zoo have 8
_MAX = {
    "num_beams": 10_000,  # alignment compares each point with each
    "num_points": 10_000,
    "num_groups": 10_000,
    "num_waypoints": 10_000,
    "num_scans": 100,  # past scans, each with all of its points
    "max_iterations": 10_000,  # of ICP, in every step
}
"""Largest value by name, far above what a robot's controller can afford."""


def check_limits(value: Any, place: str) -> None:
    """Hold every number and text of a config to the bounds, before anything of it is built.

    Args:
        value: Plain data.
        place: Name of ``value`` in messages.

    Raises:
        BundleError: At the first value beyond its bound, naming it.
    """
    for where, item in walk(value, place):
        name = where.rpartition(".")[2].partition("[")[0]
        if isinstance(item, int) and not isinstance(item, bool):
            limit = _MAX.get(name, _MAX_NUMBER)
            if abs(item) > limit:
                shown = item if abs(item) < 10**30 else "..."
                raise BundleError(f"{where}={shown}: must be at most {limit:,}")
        elif isinstance(item, str) and len(item) > _MAX_TEXT:
            raise BundleError(f"{where}: must have at most {_MAX_TEXT:,} characters")
        if where.count(".") + where.count("[") > _MAX_DEPTH:
            raise BundleError(f"{where}: must be nested at most {_MAX_DEPTH} levels deep")


def check_weights(node: Any, file: Path, allow: Sequence[str]) -> None:
    """Compare an actor's parameters with those that a file lists, before either takes memory.

    An actor of the user's own package may not be built without memory; then the bounds of
    :func:`check_limits` are all there is, as the user trusts the package.

    Args:
        node: Of the actor.
        file: Its weights, ``.safetensors``.
        allow: See :func:`navrl.policies.load_bundle`.

    Raises:
        BundleError: If the file is missing or damaged, or a parameter has another shape there.
    """
    weights = _shapes(file)
    try:
        with torch.device("meta"):
            actor = build_node(node, allow, "actor")
    except BundleError:
        if allow:
            return
        raise
    if isinstance(actor, nn.Module):  # anything else is reported by the caller
        put_weights(actor, weights, file)


def put_weights(actor: nn.Module, weights: Mapping[str, Tensor], file: Path) -> None:
    """Load weights into an actor.

    Raises:
        BundleError: If they do not fit, naming ``file`` and the first that does not.
    """
    try:
        actor.load_state_dict(weights)
    except RuntimeError as error:
        first, *others = str(error).split("\n\t")[1:] or [str(error)]
        more = f" (and {len(others)} more)" if others else ""
        raise BundleError(f"{file}: does not fit the actor: {first.strip()}{more}") from error


def _shapes(file: Path) -> dict[str, Tensor]:
    """Return tensors without memory of the shapes that a file lists."""
    try:
        with safe_open(file, framework="pt") as weights:
            shapes = {name: weights.get_slice(name).get_shape() for name in weights.keys()}  # noqa: SIM118
        return {name: torch.empty(shape, device="meta") for name, shape in shapes.items()}
    except (OSError, SafetensorError) as error:
        raise BundleError(f"{file}: {reason(error)}") from error
