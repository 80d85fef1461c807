"""The configuration that a resumed run goes on with: its own, unless the command may change it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import yaml
from omegaconf import DictConfig, OmegaConf

from navrl.factory.values import flat_values
from navrl.files import write_text
from navrl.jobs.run_folder import CONFIG_FILE, HARMLESS, differences

_RECORD = Path("checkpoint") / CONFIG_FILE  # the configuration that made the checkpoint


def record_config(cfg: DictConfig, folder: Path) -> None:
    """Store beside the checkpoint what the run is made with, so that an edit is noticed."""
    if not (folder / _RECORD).is_file():
        write_text(folder / _RECORD, OmegaConf.to_yaml(cfg))


def resumed_config(folder: Path, cfg: DictConfig, overrides: Sequence[str]) -> DictConfig:
    """Return the configuration of the run in ``folder``.

    ``device`` and values that change no result, such as ``num_threads``, are taken from the
    command. Any other value of the command must be the run's own.

    Args:
        folder: Run folder.
        cfg: As the command composed it.
        overrides: Of the command.

    Raises:
        ValueError: If there is no run, if its ``config.yaml`` was edited since it began, or if the
            command asks for another value than the run has.
    """
    file = folder / CONFIG_FILE
    if not file.is_file():
        raise ValueError(f"resume={folder}: no run there, {file} is missing")
    run = _load(file)
    _check_unedited(run, folder)
    given = _given(cfg, overrides)
    if "device" in given:
        if "device" not in run:
            raise ValueError(f"device={cfg.device}: the run in {folder} is older than this key")
        run.device = cfg.device
    for name in HARMLESS & given:
        if name in run:
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


def _load(file: Path) -> DictConfig:
    try:
        config = OmegaConf.load(file)
    except yaml.YAMLError as error:
        raise ValueError(f"{file}: damaged, no YAML ({error})") from error
    if not isinstance(config, DictConfig) or not config:
        raise ValueError(f"{file}: damaged, need a mapping")
    return config


def _check_unedited(run: DictConfig, folder: Path) -> None:
    """Compare ``config.yaml`` with the record of it; runs from before have none."""
    started = folder / _RECORD
    if not started.is_file():
        return
    edited = [
        f"{name} was {before} and is {now}"
        for name, before, now in differences(flat_values(_load(started)), flat_values(run))
    ]
    if edited:
        raise ValueError(
            f"{folder / CONFIG_FILE}: edited since the run began ({'; '.join(edited[:3])}); undo "
            "that, or start a new run"
        )


def _given(cfg: DictConfig, overrides: Sequence[str]) -> set[str]:
    """Return the keys that a command sets; ``""``, for all, if it chooses a whole experiment."""
    keys = [override.lstrip("+~").partition("=")[0] for override in overrides]
    names = {key.rpartition("@")[2].replace("/", ".") for key in keys} - {"resume"}
    known = flat_values(cfg)
    return {name if any(_is_given(key, {name}) for key in known) else "" for name in names}


def _is_given(name: str, given: set[str]) -> bool:
    return any(not key or name == key or name.startswith(f"{key}.") for key in given)
