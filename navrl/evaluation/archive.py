"""Archive of an evaluation's recordings: all episodes or the failed ones."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from torchrl.envs import TransformedEnv

from navrl.evaluation.kept import KEPT, is_kept
from navrl.evaluation.recorder import EpisodeRecorder
from navrl.evaluation.results import EPISODES
from navrl.evaluation.rollout import ERROR, EpisodeRecord
from navrl.worlds import Scenario

RECORDINGS = "recordings"
"""Subfolder of an evaluation."""


def missing_recordings(folder: Path, keep: str) -> bool:
    """Return whether recordings required by ``keep`` are missing in an evaluation's folder.

    Args:
        folder: Folder of the evaluation, with ``episodes.csv``.
        keep: One of :data:`navrl.evaluation.kept.KEPT`.
    """
    if keep == "none":
        return False
    with (folder / EPISODES).open(newline="") as file:
        rows = [(int(row["index"]), row["outcome"]) for row in csv.DictReader(file)]
    wanted = [index for index, outcome in rows if outcome != ERROR and is_kept(outcome, keep)]
    return not all(_file(folder / RECORDINGS, index).is_file() for index in wanted)


def _file(folder: Path, index: int) -> Path:
    return folder / f"{index:06d}.npz"


class EpisodeArchive(EpisodeRecorder):
    """Recorder that writes files, the ``recorder`` of :func:`navrl.evaluation.evaluate`.

    It does not affect the results.

    Args:
        env: Environment of the evaluation, with ``privileged=True``.
        scenarios: All played scenarios, by index.
        folder: Folder of the files ``<index>.npz``, see
            :class:`navrl.evaluation.recording.Recording`.
        keep: ``failures`` (all except successes) or ``all``.

    Raises:
        ValueError: If ``keep`` is neither.
    """

    def __init__(
        self,
        env: TransformedEnv,
        scenarios: Sequence[Scenario],
        folder: Path,
        keep: str = "all",
    ) -> None:
        if keep not in KEPT[1:]:
            raise ValueError(f"keep={keep}: must be one of {', '.join(KEPT[1:])}")
        super().__init__(env)
        self._scenarios, self._folder, self._keep = scenarios, folder, keep

    def begin(self, chunk: range) -> None:
        """Discard the steps collected before."""
        self.clear()

    def end(self, chunk: range, records: list[EpisodeRecord]) -> None:
        """Write the selected episodes."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for row, record in enumerate(records):
            if is_kept(record.outcome, self._keep):
                recording = self.recording(row, self._scenarios[record.index], record)
                recording.save(_file(self._folder, record.index), compact=True)
        self.clear()
