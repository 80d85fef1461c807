"""A job's folder: the configuration it was started with, so that the same command goes on in it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from navrl.factory.values import flat_values
from navrl.files import write_text

CONFIG_FILE = "config.yaml"
# Neither how it is played, nor what is kept or checked of it, changes a result.
HARMLESS = {"num_threads", "num_processes", "progress_bar", "recordings", "latency", "resume"}
_CHECKS = ("suite.version",)


def claim_folder(cfg: DictConfig, folder: Path) -> None:
    """Write ``cfg`` to ``folder/config.yaml``, or see that the same is there already.

    Two configurations in one folder would mix their results; a job of a sweep that is started
    again finds its own. Hold :func:`navrl.jobs.run_lock.locked` meanwhile.

    Args:
        cfg: What is about to run.
        folder: Where its results go; made if it is missing.

    Raises:
        ValueError: If another configuration has run there, naming what differs.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / CONFIG_FILE
    if file.is_file():
        there, here = flat_values(OmegaConf.load(file)), flat_values(cfg)
        different = [
            f"{name} is {old} there and {new} here" for name, old, new in differences(there, here)
        ]
        if different:
            shown = "; ".join(different[:3]) + ("; ..." if len(different) > 3 else "")
            raise ValueError(
                f"{folder}: holds a run of another configuration ({shown}); choose another "
                "hydra.run.dir or hydra.sweep.dir"
            )
    write_text(file, OmegaConf.to_yaml(cfg))


def result_values(cfg: DictConfig) -> dict[str, Any]:
    """Return the values of :func:`flat_values` that may change a result."""
    return {name: value for name, value in flat_values(cfg).items() if _matters(name)}


def _matters(name: str) -> bool:
    return name.split(".")[0] not in HARMLESS and name not in _CHECKS


def differences(there: dict[str, Any], here: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    """Return name and both values of what may change a result; ``"missing"`` of a missing one."""
    pairs = [
        (name, there.get(name, "missing"), here.get(name, "missing"))
        for name in {**there, **here}
        if _matters(name)
    ]
    return [(name, old, new) for name, old, new in pairs if old != new]
