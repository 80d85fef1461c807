"""Results of finished chunks of an interrupted evaluation, one file per chunk."""

from __future__ import annotations

import logging
import shutil
from dataclasses import asdict
from pathlib import Path

from navrl.evaluation.rollout import EpisodeRecord
from navrl.files import write_json, write_text
from navrl.untrusted import DamagedFileError, read_json, read_text

LOG = logging.getLogger(__name__)
_KEY = "key.txt"
_REMEDY = "the chunk is played again"


class FinishedChunks:
    """Store of the records of finished chunks, from which the same command resumes.

    Args:
        folder: Folder of the chunks only; cleared if they belong to another evaluation.
        key: Identifies the evaluation: equal keys mean equal records.

    Attributes:
        is_new: Whether no chunk of this evaluation existed.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self._folder = folder
        there = folder / _KEY
        self.is_new = not (folder.is_dir() and _holds(there, key))
        if folder.is_dir() and self.is_new:
            shutil.rmtree(folder)
        write_text(there, key)

    def load(self, chunk: range) -> list[EpisodeRecord] | None:
        """Return the records of ``chunk``, or ``None`` if it is unfinished or damaged."""
        file = self._file(chunk)
        if not file.is_file():
            return None
        try:
            records = [EpisodeRecord(**plain) for plain in read_json(file, _REMEDY, list)]
            if [record.index for record in records] != list(chunk):
                raise DamagedFileError(file, "holds other episodes", _REMEDY)
        except (TypeError, DamagedFileError) as error:
            LOG.warning("%s", error if isinstance(error, DamagedFileError) else f"{file}: {error}")
            return None
        return records

    def save(self, chunk: range, records: list[EpisodeRecord]) -> None:
        """Store the records of ``chunk`` atomically."""
        write_json(self._file(chunk), [asdict(record) for record in records])

    def clear(self) -> None:
        """Remove all files of a finished evaluation."""
        shutil.rmtree(self._folder)

    def _file(self, chunk: range) -> Path:
        return self._folder / f"{chunk.start:06d}-{chunk.stop:06d}.json"


def _holds(file: Path, text: str) -> bool:
    try:
        return file.is_file() and read_text(file, _REMEDY) == text
    except DamagedFileError:
        return False
