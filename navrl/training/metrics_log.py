"""Training log: a CSV file, mirrored to loggers."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from navrl.files import replacing
from navrl.training.loggers import Loggers

LOG_FILE = "metrics.csv"


class MetricsLog:
    """Log of named scalars in ``metrics.csv``, mirrored to loggers.

    Rows may have different columns (evaluations are less frequent than training reports): missing
    cells are empty, and a new column is added to the whole file.

    Args:
        folder: Run folder.
        resume_frames: Frame count of the checkpoint that the run resumes from. Later rows are
            dropped, because they are written again. ``None`` drops all rows.
        resume_rows: Number of rows when that checkpoint was saved; later rows are dropped too.
            ``None`` if it is unknown.
        loggers: Open loggers that receive the same scalars; ``None`` for none.

    Raises:
        ValueError: If the file of the run that resumes is damaged.
    """

    def __init__(
        self,
        folder: Path,
        resume_frames: int | None = None,
        resume_rows: int | None = None,
        loggers: Loggers | None = None,
    ) -> None:
        self._file = Path(folder) / LOG_FILE
        self._columns: list[str] = ["frames", "updates"]
        self.num_rows = 0
        if self._file.is_file():
            self._keep_until(-1 if resume_frames is None else resume_frames, resume_rows)
        self._loggers = loggers

    def log(self, frames: int, updates: int, metrics: Mapping[str, float]) -> None:
        """Write and flush one row, so that it persists if the process is killed.

        Raises:
            OSError: If writing fails; the message names the file.
        """
        row = {"frames": frames, "updates": updates, **metrics}
        fresh = [name for name in row if name not in self._columns]
        if fresh or not self._file.is_file():
            self._columns += fresh
            self._rewrite(self._rows())
        cells = {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()}
        try:
            with self._file.open("a", encoding="utf-8", newline="") as file:
                file.write(self._csv([cells]))
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._file)) from error
        self.num_rows += 1
        if self._loggers is not None:
            self._loggers.log(frames, metrics)

    def log_video(self, name: str, file: Path | None, frames: int) -> None:
        """Send an animation (``.gif``) to the loggers; nothing if it is ``None``."""
        if self._loggers is not None and file is not None:
            self._loggers.log_video(name, file, frames)

    def synchronize(self) -> None:
        """Write all rows to disk, so that the file has at least the rows of a checkpoint."""
        if self._file.is_file():
            with self._file.open("rb") as file:
                os.fsync(file.fileno())

    def close(self) -> None:
        """Close the loggers."""
        if self._loggers is not None:
            self._loggers.close()

    def _rows(self) -> list[dict[str, str]]:
        """Return the complete rows; a row truncated by a kill has no line end."""
        if not self._file.is_file():
            return []
        text = self._file.read_bytes().decode("utf-8", errors="replace")
        whole = text[: text.rfind("\n") + 1]
        return list(csv.DictReader(io.StringIO(whole, newline="")))

    def _keep_until(self, frames: int, rows: int | None) -> None:
        found = self._rows()[:rows]
        if not all(_is_valid(row) for row in found):
            raise ValueError(
                f"{self._file}: damaged, each row must have a whole number of frames and no more "
                "cells than the header; put it back from a copy of the run, or move it away"
            )
        self._columns = list(dict.fromkeys([*self._columns, *(k for r in found for k in r)]))
        found = [row for row in found if int(row["frames"]) <= frames]
        self._rewrite(found)
        self.num_rows = len(found)

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        header = dict(zip(self._columns, self._columns, strict=True))
        with replacing(self._file) as file:
            file.write(self._csv([header, *rows]).encode())

    def _csv(self, rows: Sequence[Mapping[str, object]]) -> str:
        text = io.StringIO(newline="")
        csv.DictWriter(text, self._columns).writerows(rows)
        return text.getvalue()


def _is_valid(row: Mapping[Any, str | None]) -> bool:
    """Return whether a row read from the file has a frame count and only named columns."""
    return (row.get("frames") or "").isdecimal() and None not in row
