"""Configuration of a resumed run: its own, except for values the command may change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from navrl.factory.values import flat_values
from navrl.files import write_text
from navrl.jobs.run_folder import CONFIG_FILE, RESULT_NEUTRAL, differences, load_config

_RECORD = Path("checkpoint") / CONFIG_FILE  # the configuration of the checkpoint


def record_config(cfg: DictConfig, folder: Path) -> None:
    """Store the run's configuration with the checkpoint, to detect later edits."""
    if not (folder / _RECORD).is_file():
        write_text(folder / _RECORD, OmegaConf.to_yaml(cfg))


def resumed_config(folder: Path, cfg: DictConfig, overrides: Sequence[str]) -> DictConfig:
    """Return the configuration of the run in ``folder``.

    ``device`` and values that do not change results, such as ``num_threads``, are taken from the
    command. Any other value of the command must equal the run's.

    Args:
        folder: Run folder.
        cfg: Configuration composed by the command.
        overrides: Overrides of the command.

    Raises:
        ValueError: If there is no run, if its ``config.yaml`` was edited since the run began, or if
            a value of the command differs from the run's.
    """
    file = folder / CONFIG_FILE
    if not file.is_file():
        raise ValueError(f"resume={folder}: no run there, {file} is missing")
    run = load_config(file)
    _check_unedited(run, folder)
    given = _given(cfg, overrides)
    if "device" in given:
        if "device" not in run:
            raise ValueError(f"device={cfg.device}: the run in {folder} is older than this key")
        run.device = cfg.device
    for name in RESULT_NEUTRAL & {key.partition(".")[0] for key in given}:
        if name in cfg:
            run[name] = cfg[name]
    different = [
        f"{name}={here}: the run has {name}={there}"
        for name, there, here in differences(flat_values(run), flat_values(cfg))
        if _is_given(name, given) and name != "device"
    ]
    if different:
        raise ValueError(
            f"{'; '.join(different[:3])}; resume={folder} keeps the run's own configuration: leave "
            "this out, or start a new run"
        )
    return run


def _check_unedited(run: DictConfig, folder: Path) -> None:
    """Compare ``config.yaml`` with its stored copy, which older runs lack."""
    started = folder / _RECORD
    if not started.is_file():
        return
    edited = [
        f"{name} was {before} and is {now}"
        for name, before, now in differences(flat_values(load_config(started)), flat_values(run))
    ]
    if edited:
        raise ValueError(
            f"{folder / CONFIG_FILE}: edited since the run began ({'; '.join(edited[:3])}); undo "
            "that, or start a new run"
        )


def _given(cfg: DictConfig, overrides: Sequence[str]) -> set[str]:
    """Return the keys that a command sets; ``""`` (all) if it selects an experiment."""
    keys = [override.lstrip("+~").partition("=")[0] for override in overrides]
    names = {key.rpartition("@")[2].replace("/", ".") for key in keys} - {"resume"}
    known = flat_values(cfg)
    return {name if any(_is_given(key, {name}) for key in known) else "" for name in names}


def _is_given(name: str, given: set[str]) -> bool:
    return any(not key or name == key or name.startswith(f"{key}.") for key in given)
