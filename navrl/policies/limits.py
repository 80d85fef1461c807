"""Bounds on a bundle's values, so that loading it allocates little memory.

A network is first built without memory and compared with the shapes of the weights file, so its
size is bounded by that file. All other sizes are bounded by name, and products of them by the
transforms that allocate them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from navrl.policies.nodes import BundleError, build_node, reason, walk

_MAX_NUMBER = 100_000  # maximum integer: a sensor's beams, a layer's units
_MAX_TEXT = 1_000  # maximum number of characters: keys and names
_MAX_DEPTH = 50  # maximum nesting of nodes; the zoo has 8
_MAX = {
    "num_beams": 10_000,  # alignment compares each point with each
    "num_points": 10_000,
    "num_groups": 10_000,
    "num_waypoints": 10_000,
    "num_scans": 100,  # past scans with all points
    "max_iterations": 10_000,  # ICP iterations per step
}
"""Maximum value by name, far above practical values."""


def check_limits(value: Any, place: str) -> None:
    """Check every number and text of a config against the bounds before building it.

    Args:
        value: Plain data.
        place: Name of ``value`` in messages.

    Raises:
        BundleError: If a value exceeds its bound; the message names the first one.
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
    """Compare an actor's parameters with the shapes in a file before allocating memory.

    If an actor of the user's own package cannot be built without memory, only the bounds of
    :func:`check_limits` apply, since the user trusts the package.

    Args:
        node: Configuration node of the actor.
        file: Weights file, ``.safetensors``.
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
    if isinstance(actor, nn.Module):  # the caller reports other types
        put_weights(actor, weights, file)


def put_weights(actor: nn.Module, weights: Mapping[str, Tensor], file: Path) -> None:
    """Load weights into an actor.

    Raises:
        BundleError: If they do not fit; the message has ``file`` and the first mismatch.
    """
    try:
        actor.load_state_dict(weights)
    except RuntimeError as error:
        first, *others = str(error).split("\n\t")[1:] or [str(error)]
        more = f" (and {len(others)} more)" if others else ""
        raise BundleError(f"{file}: does not fit the actor: {first.strip()}{more}") from error


def _shapes(file: Path) -> dict[str, Tensor]:
    """Return meta tensors with the shapes listed in a file."""
    try:
        with safe_open(file, framework="pt") as weights:
            shapes = {name: weights.get_slice(name).get_shape() for name in weights.keys()}  # noqa: SIM118
        return {name: torch.empty(shape, device="meta") for name, shape in shapes.items()}
    except (OSError, SafetensorError) as error:
        raise BundleError(f"{file}: {reason(error)}") from error
