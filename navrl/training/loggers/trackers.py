"""Loggers of experiment trackers: Weights & Biases, MLflow and Trackio.

Each run has an ID, saved in ``<run folder>/loggers.json``, so that a resumed training continues the
same run of the tracker. Values logged after the last checkpoint are logged again by a resumed run.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchrl.record.loggers import Logger, MLFlowLogger, WandbLogger
from torchrl.record.loggers.trackio import TrackioLogger

from navrl.extras import require
from navrl.files import write_json
from navrl.untrusted import DamagedFileError, read_json

IDS_FILE = "loggers.json"


@dataclass(frozen=True)
class WandB:
    """A run of Weights & Biases, stored in ``<run folder>/wandb``.

    Args:
        project: Name of the project.
        mode: ``offline`` (files only, uploaded by ``wandb sync``) or ``online``.
        options: Further arguments of ``wandb.init``, e.g. ``entity``, ``group`` or ``tags``.

    Raises:
        ModuleNotFoundError: If wandb is not installed.
        ValueError: If the mode is none of the above.
    """

    project: str
    mode: str = "offline"
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the package is installed."""
        require("wandb", "logger=wandb", "wandb")
        if self.mode not in ("offline", "online"):
            raise ValueError(f"mode={self.mode}: must be offline or online")

    def open(self, folder: Path, resume_frames: int | None) -> Logger:
        """Open the logger; see :meth:`navrl.training.loggers.RunLogger.open`."""
        run = _saved_id(folder, "wandb") or secrets.token_hex(4)
        _save_id(
            folder, "wandb", run
        )  # before the run exists: an interruption leaves no second one
        return _WandbLogger(
            exp_name=folder.resolve().name,
            save_dir=str(folder),
            id=run,
            project=self.project,
            log_env_packages=False,  # W&B records the packages itself
            mode=self.mode,  # TorchRL's offline=True would change the environment of the process
            **self.options,
        )


@dataclass(frozen=True)
class MLflow:
    """A run of MLflow, by default in a database beside the run folder.

    Args:
        experiment: Name of the experiment.
        tracking_uri: Address of a tracking server or database. ``None``:
            ``sqlite:///<parent of the run folder>/mlflow.db``, which the runs of a folder share.
        artifacts: Address of videos. ``None``: ``mlflow_artifacts`` beside that database, or the
            server's default.

    Raises:
        ModuleNotFoundError: If mlflow is not installed.
    """

    experiment: str
    tracking_uri: str | None = None
    artifacts: str | None = None

    def __post_init__(self) -> None:
        """Check that the package is installed."""
        require("mlflow", "logger=mlflow", "mlflow", "sqlalchemy")

    def open(self, folder: Path, resume_frames: int | None) -> Logger:
        """Open the logger; see :meth:`navrl.training.loggers.RunLogger.open`."""
        uri, artifacts, folder = self.tracking_uri, self.artifacts, folder.resolve()
        if uri is None:
            uri = f"sqlite:///{folder.parent / 'mlflow.db'}"
            artifacts = artifacts or (folder.parent / "mlflow_artifacts").as_uri()
        saved = _saved_id(folder, "mlflow")
        logger = _MLflowLogger(self.experiment, uri, artifacts, folder.name, saved)
        _save_id(folder, "mlflow", logger.experiment.info.run_id)
        return logger


@dataclass(frozen=True)
class Trackio:
    """A run of Trackio, stored by the package (``TRACKIO_DIR``) or in a Space of Hugging Face.

    Its name is that of the run folder with an ID, because Trackio identifies runs by name.

    Args:
        project: Name of the project.
        options: Further arguments of ``trackio.init``, e.g. ``space_id`` or ``group``.

    Raises:
        ModuleNotFoundError: If trackio is not installed.
    """

    project: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the package is installed."""
        require("trackio", "logger=trackio", "trackio")

    def open(self, folder: Path, resume_frames: int | None) -> Logger:
        """Open the logger; see :meth:`navrl.training.loggers.RunLogger.open`."""
        run = _saved_id(folder, "trackio") or secrets.token_hex(4)
        _save_id(folder, "trackio", run)
        name = f"{folder.resolve().name}-{run}"
        return _TrackioLogger(name, self.project, embed=False, **self.options)


class _WandbLogger(WandbLogger):
    def log_gif(self, name: str, file: Path, step: int) -> None:
        """Log an animation; TorchRL's ``log_video`` needs moviepy."""
        import wandb

        self._log_payload({name: wandb.Video(str(file), format="gif")}, step=step)


class _MLflowLogger(MLFlowLogger):
    def __init__(
        self, experiment: str, uri: str, artifacts: str | None, name: str, run: str | None
    ) -> None:
        self._run_name, self._run = name, run  # read while TorchRL's constructor starts the run
        super().__init__(experiment, uri, artifact_location=artifacts)

    def _create_experiment(self) -> object:
        """Start the run, or continue the saved one, which TorchRL's logger cannot."""
        import mlflow

        name = self._mlflow_kwargs["name"]
        found = mlflow.get_experiment_by_name(name)
        created = None if found else mlflow.create_experiment(**self._mlflow_kwargs)
        self.id = found.experiment_id if found else created
        return mlflow.start_run(self._run, experiment_id=self.id, run_name=self._run_name)

    def log_gif(self, name: str, file: Path, step: int) -> None:
        """Log an animation as an artifact; TorchRL's ``log_video`` needs torchcodec."""
        import mlflow

        mlflow.log_artifact(str(file), f"videos/{name}")

    def close(self, timeout: float | None = None) -> None:
        """End the run."""
        import mlflow

        mlflow.end_run()


class _TrackioLogger(TrackioLogger):
    def log_metrics(
        self, metrics: Mapping[str, float], step: int | None = None, **_: Any
    ) -> dict[str, Any]:
        """Log scalars in one row; TorchRL's logger writes a row for each."""
        self.experiment.log(dict(metrics), step=step)
        return dict(metrics)

    def log_gif(self, name: str, file: Path, step: int) -> None:
        """Log an animation."""
        import trackio

        self.experiment.log({name: trackio.Video(str(file))}, step=step)


def _ids(folder: Path) -> dict[str, Any]:
    file = folder / IDS_FILE
    return read_json(file, _REMEDY) if file.is_file() else {}


_REMEDY = "restore it, or delete it to log to new runs"


def _saved_id(folder: Path, name: str) -> str | None:
    """Return the ID of the tracker's run, ``None`` for a new one."""
    saved = _ids(folder).get(name)
    if saved is not None and not isinstance(saved, str):
        raise DamagedFileError(folder / IDS_FILE, f"{name} must be text", _REMEDY)
    return saved


def _save_id(folder: Path, name: str, run: str) -> None:
    ids = _ids(folder)
    if ids.get(name) != run:
        write_json(folder / IDS_FILE, {**ids, name: run})
