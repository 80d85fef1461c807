"""Configs: where they are, how they are composed, and how their errors are told."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hydra
from omegaconf import DictConfig

CONF_DIR = next(
    folder
    for folder in (Path(__file__).parent / "conf", Path(__file__).parent.parent / "conf")
    if folder.is_dir()
)


def compose(config_name: str, overrides: Sequence[str] = ()) -> DictConfig:
    with hydra.initialize_config_dir(version_base="1.3", config_dir=str(CONF_DIR.resolve())):
        return hydra.compose(config_name, list(overrides))


def instantiate(node: Any, **kwargs: Any) -> Any:
    return hydra.utils.instantiate(node, _convert_="all", **kwargs)
