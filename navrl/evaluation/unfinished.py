"""What is finished of an evaluation that may be cut off: a file for each chunk of episodes."""

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
    """Keep the records of chunks that were played, so that the same command goes on after them.

    Args:
        folder: Made for this alone; cleared if it holds chunks of another evaluation.
        key: Says which evaluation: equal keys mean equal records.

    Attributes:
        is_new: Whether no chunk of this evaluation was there.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self._folder = folder
        there = folder / _KEY
        self.is_new = not (folder.is_dir() and _holds(there, key))
        if folder.is_dir() and self.is_new:
            shutil.rmtree(folder)
        write_text(there, key)

    def load(self, chunk: range) -> list[EpisodeRecord] | None:
        """Return the records of ``chunk``, or ``None`` if it was not finished or is damaged."""
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
        """Keep the records of ``chunk``: all of them or, if that is cut off, none."""
        write_json(self._file(chunk), [asdict(record) for record in records])

    def clear(self) -> None:
        """Remove everything: the evaluation is finished."""
        shutil.rmtree(self._folder)

    def _file(self, chunk: range) -> Path:
        return self._folder / f"{chunk.start:06d}-{chunk.stop:06d}.json"


def _holds(file: Path, text: str) -> bool:
    try:
        return file.is_file() and read_text(file, _REMEDY) == text
    except DamagedFileError:
        return False
