"""What is finished of an evaluation that may be cut off: a file for each chunk of episodes."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path

from navrl.evaluation.rollout import EpisodeRecord

_KEY = "key.txt"


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
        self.is_new = not (there.is_file() and there.read_text() == key)
        if folder.is_dir() and self.is_new:
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        there.write_text(key)

    def load(self, chunk: range) -> list[EpisodeRecord] | None:
        """Return the records of ``chunk``, or ``None`` if it was not finished."""
        file = self._file(chunk)
        if not file.is_file():
            return None
        return [EpisodeRecord(**plain) for plain in json.loads(file.read_text())]

    def save(self, chunk: range, records: list[EpisodeRecord]) -> None:
        """Keep the records of ``chunk``: all of them or, if that is cut off, none."""
        file = self._file(chunk)
        fresh = file.with_name(f"{file.name}.{os.getpid()}.tmp")
        fresh.write_text(json.dumps([asdict(record) for record in records]))
        fresh.replace(file)

    def clear(self) -> None:
        """Remove everything: the evaluation is finished."""
        shutil.rmtree(self._folder)

    def _file(self, chunk: range) -> Path:
        return self._folder / f"{chunk.start:06d}-{chunk.stop:06d}.json"
