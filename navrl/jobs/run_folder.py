"""Folder of a job with the configuration of its start, checked when it is resumed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf

from navrl.deprecated_groups import renamed_groups
from navrl.factory.values import flat_values
from navrl.files import write_text

CONFIG_FILE = "config.yaml"
# Keys that do not change results.
RESULT_NEUTRAL = {
    *("num_threads", "num_processes", "progress_bar", "recordings", "latency", "resume"),
    *("logger", "video_every_validations"),
}
_CHECKS = ("suite.version",)


def claim_folder(cfg: DictConfig, folder: Path) -> None:
    """Write ``cfg`` to ``folder/config.yaml``, or check that the existing one is equal.

    Two configurations in one folder would mix their results; a restarted job of a sweep finds its
    own configuration. Call this while holding :func:`navrl.jobs.run_lock.locked`.

    Args:
        cfg: Configuration of the job.
        folder: Folder of its results; created if missing.

    Raises:
        ValueError: If the folder has another configuration; the message lists the differences.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / CONFIG_FILE
    if file.is_file():
        there, here = flat_values(load_config(file)), flat_values(cfg)
        different = [
            f"{name} is {old} there and {new} here" for name, old, new in differences(there, here)
        ]
        if different:
            shown = "; ".join(different[:3]) + ("; ..." if len(different) > 3 else "")
            raise ValueError(
                f"{folder}: has a run of another configuration ({shown}); choose another "
                "hydra.run.dir or hydra.sweep.dir"
            )
    write_text(file, OmegaConf.to_yaml(cfg))


def load_config(file: Path) -> DictConfig:
    """Read the configuration of a run; groups of an older version get their present names.

    Raises:
        ValueError: If the file is damaged.
    """
    try:
        config = OmegaConf.to_container(OmegaConf.load(file), resolve=False)
    except yaml.YAMLError as error:
        raise ValueError(f"{file}: damaged, not YAML ({error})") from error
    if not isinstance(config, Mapping) or not config:
        raise ValueError(f"{file}: damaged, must be a mapping")
    return OmegaConf.create(renamed_groups(config))


def result_values(cfg: DictConfig) -> dict[str, Any]:
    """Return the values of :func:`flat_values` that may change a result."""
    return {name: value for name, value in flat_values(cfg).items() if _affects_results(name)}


def _affects_results(name: str) -> bool:
    return name.split(".")[0] not in RESULT_NEUTRAL and name not in _CHECKS


def differences(there: dict[str, Any], here: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    """Return name and both values of differences; ``"missing"`` for a missing value."""
    pairs = [
        (name, there.get(name, "missing"), here.get(name, "missing"))
        for name in {**there, **here}
        if _affects_results(name)
    ]
    return [(name, old, new) for name, old, new in pairs if old != new]
