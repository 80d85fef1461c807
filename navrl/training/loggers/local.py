"""Loggers that write files of the run folder: TensorBoard and CSV."""

from __future__ import annotations

import shutil
from pathlib import Path

from PIL import Image
from tensorboard.compat.proto import summary_pb2
from torch.utils.tensorboard import SummaryWriter
from torchrl.record.loggers import CSVLogger, TensorboardLogger

from navrl.files import replacing


class TensorBoard:
    """TensorBoard events in ``<run folder>/tensorboard``.

    Events later than the checkpoint of a resumed run are hidden by its purge step. The
    configuration is not logged, because TensorBoard shows it as a further run.
    """

    def open(self, folder: Path, resume_frames: int | None) -> TensorboardLogger:
        """Open the logger; see :meth:`navrl.training.loggers.RunLogger.open`."""
        purge = None if resume_frames is None else resume_frames + 1
        return _TensorBoardLogger("tensorboard", str(folder), purge)


class CSV:
    """One CSV file per scalar, rows ``frames,value``, in ``<run folder>/csv/scalars``.

    Rows later than the checkpoint of a resumed run are removed, because they are written again.
    """

    def open(self, folder: Path, resume_frames: int | None) -> CSVLogger:
        """Open the logger; see :meth:`navrl.training.loggers.RunLogger.open`."""
        last = -1 if resume_frames is None else resume_frames
        for file in (folder / "csv" / "scalars").rglob("*.csv"):
            _retain_until(file, last)
        return _CSVLogger("csv", str(folder))


class _TensorBoardLogger(TensorboardLogger):
    def __init__(self, exp_name: str, log_dir: str, purge_step: int | None) -> None:
        self._purge_step = purge_step  # read while TorchRL's constructor opens the file
        super().__init__(exp_name, log_dir)

    def _create_experiment(self) -> SummaryWriter:
        folder = Path(self.log_dir) / self.exp_name
        return SummaryWriter(str(folder), purge_step=self._purge_step)

    def log_hparams(self, *_: object, **__: object) -> None:
        """Log nothing: see :class:`TensorBoard`."""

    def log_gif(self, name: str, file: Path, step: int) -> None:
        """Log an animation; TorchRL's ``log_video`` needs a release of moviepy before 2."""
        kind = summary_pb2.Summary  # pyright: ignore[reportAttributeAccessIssue]
        with Image.open(file) as image:
            width, height = image.size
        content = kind.Image(
            height=height, width=width, colorspace=3, encoded_image_string=file.read_bytes()
        )
        summary = kind(value=[kind.Value(tag=name, image=content)])
        self.experiment._get_file_writer().add_summary(summary, step)


class _CSVLogger(CSVLogger):
    def log_gif(self, name: str, file: Path, step: int) -> None:
        """Copy an animation to ``videos/<name>_<step>.gif``."""
        copy = Path(self.log_dir) / self.exp_name / "videos" / f"{name}_{step}.gif"
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)

    def close(self, timeout: float | None = None) -> None:
        """Close the files, which TorchRL leaves to the garbage collector."""
        super().close(timeout)
        for file in self.experiment.files.values():
            file.close()


def _retain_until(file: Path, frames: int) -> None:
    """Rewrite a file of the CSV logger without rows after ``frames`` and incomplete rows."""
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("\n") and int(line.split(",")[0]) <= frames]
    if whole != lines:
        with replacing(file) as stream:
            stream.write("".join(whole).encode())
