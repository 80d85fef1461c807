"""Values of a configuration by dotted name."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf


def flat_values(cfg: DictConfig | ListConfig) -> dict[str, Any]:
    """Return all values of a config by dotted name, with unresolved interpolations."""
    return dict(_leaves(OmegaConf.to_container(cfg, resolve=False)))


def _leaves(node: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value below ``node`` with its dotted name."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _leaves(value, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, node
