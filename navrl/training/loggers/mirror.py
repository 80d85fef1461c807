"""Mirror of the training log: all loggers of a run behind one object."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from PIL import Image, ImageSequence
from torchrl.record.loggers import Logger

LOG = logging.getLogger(__name__)


class RunLogger(Protocol):
    """Settings of a logger, a node of the configuration group ``logger``.

    Checked when the trainer is built; opened when the training starts.
    """

    def open(self, folder: Path, resume_frames: int | None) -> Logger:
        """Return the open TorchRL logger of a run.

        Args:
            folder: Run folder.
            resume_frames: Frame count of the checkpoint that the run resumes from; later values
                are logged again. ``None`` for a new run.
        """
        ...


class Loggers:
    r"""Open loggers of a run.

    A logger that raises while training, e.g. because its server is unreachable, is reported once
    and not used again; the training and the other loggers continue.

    Args:
        settings: Settings by name.
        folder: Run folder.
        resume_frames: Frame count of the checkpoint that the run resumes from, ``None`` for a new
            run.
        hparams: Configuration of the run by dotted name, logged by a new run.

    Raises:
        ValueError: If a logger cannot be opened.

    Example:
        >>> import tempfile
        >>> from navrl.training.loggers import CSV
        >>> folder = Path(tempfile.mkdtemp())
        >>> loggers = Loggers({"csv": CSV()}, folder)
        >>> loggers.log(100, {"train/success_rate": 0.5})
        >>> loggers.close()
        >>> (folder / "csv/scalars/train/success_rate.csv").read_text()
        '100,0.5\n'
    """

    def __init__(
        self,
        settings: Mapping[str, RunLogger],
        folder: Path,
        resume_frames: int | None = None,
        hparams: Mapping[str, Any] | None = None,
    ) -> None:
        """Open all loggers."""
        self._loggers: dict[str, Logger] = {}
        for name, logger in settings.items():
            try:
                self._loggers[name] = logger.open(folder, resume_frames)
            except OSError:
                self.close()
                raise
            except Exception as error:
                self.close()
                reason = _first_line(error)
                raise ValueError(f"logger.{name}: could not be opened ({reason})") from error
        if hparams and resume_frames is None:
            self._call(lambda logger: logger.log_hparams(dict(hparams)))

    def log(self, frames: int, metrics: Mapping[str, float]) -> None:
        """Log scalars by name at a frame count."""
        self._call(lambda logger: logger.log_metrics(dict(metrics), step=frames))

    def log_video(self, name: str, file: Path, frames: int) -> None:
        """Log an animation.

        Args:
            name: Name of the video in the logger.
            file: ``.gif``.
            frames: Frame count of the training.
        """

        def log(logger: Logger) -> None:
            log_file = getattr(logger, "log_gif", None)
            if log_file is not None:
                log_file(name, file, frames)
            else:
                logger.log_video(name, gif_frames(file), step=frames)

        self._call(log)

    def close(self) -> None:
        """Write everything and close all loggers."""
        self._call(lambda logger: logger.close())
        self._loggers.clear()

    def _call(self, method: Callable[[Logger], object]) -> None:
        for name, logger in list(self._loggers.items()):
            try:
                method(logger)
            except Exception as error:
                del self._loggers[name]
                LOG.warning(
                    "logger.%s: not used any more (%s); metrics.csv has all numbers",
                    name,
                    _first_line(error),
                )


def gif_frames(file: Path) -> torch.Tensor:
    """Return the frames of an animation as ``[1, T, 3, H, W]`` uint8, TorchRL's video format."""
    with Image.open(file) as image:
        frames = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)]
    return torch.from_numpy(np.stack(frames)).permute(0, 3, 1, 2)[None]


def _first_line(error: Exception) -> str:
    text = str(error).strip()
    return f"{type(error).__name__}: {text.splitlines()[0]}" if text else type(error).__name__
