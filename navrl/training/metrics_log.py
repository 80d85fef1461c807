"""Where training numbers go: one CSV file and TensorBoard."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter


class MetricsLog:
    """Append rows of named scalars to ``metrics.csv`` and mirror them to TensorBoard.

    Rows may have different columns (an evaluation happens less often than a training report):
    what a row lacks stays empty, and a new column is added to the whole file.

    Args:
        folder: Run folder.
        tensorboard: Whether TensorBoard events are written too.
        resume_frames: Rows beyond this frame count are dropped: they come from after the
            checkpoint that the run resumes from, and will be written again.
    """

    def __init__(
        self, folder: Path, tensorboard: bool = True, resume_frames: int | None = None
    ) -> None:
        self._file = Path(folder) / "metrics.csv"
        self._columns: list[str] = ["frames", "updates"]
        if self._file.is_file():
            self._keep_until(-1 if resume_frames is None else resume_frames)
        purge = None if resume_frames is None else resume_frames + 1
        self._writer = (
            SummaryWriter(str(Path(folder) / "tensorboard"), purge_step=purge)
            if tensorboard
            else None
        )

    def log(self, frames: int, updates: int, metrics: Mapping[str, float]) -> None:
        """Write one row and flush it, so that a kill loses nothing that was logged."""
        row = {"frames": frames, "updates": updates, **metrics}
        fresh = [name for name in row if name not in self._columns]
        if fresh:
            self._columns += fresh
            self._rewrite(self._rows())
        elif not self._file.is_file():
            self._rewrite([])
        with self._file.open("a", newline="") as file:
            csv.DictWriter(file, self._columns).writerow(
                {k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()}
            )
        if self._writer is not None:
            for name, value in metrics.items():
                self._writer.add_scalar(name, value, frames)

    def close(self) -> None:
        """Flush TensorBoard."""
        if self._writer is not None:
            self._writer.close()

    def _rows(self) -> list[dict[str, str]]:
        if not self._file.is_file():
            return []
        with self._file.open(newline="") as file:
            return list(csv.DictReader(file))

    def _keep_until(self, frames: int) -> None:
        rows = self._rows()
        self._columns = list(dict.fromkeys([*self._columns, *(k for r in rows for k in r)]))
        self._rewrite([row for row in rows if int(row["frames"]) <= frames])

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        fresh = self._file.with_suffix(".tmp")
        with fresh.open("w", newline="") as file:
            writer = csv.DictWriter(file, self._columns)
            writer.writeheader()
            writer.writerows(rows)
        fresh.replace(self._file)
