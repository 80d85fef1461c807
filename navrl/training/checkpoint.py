"""Checkpoints that a ``kill -9`` at any moment leaves whole."""

from __future__ import annotations

import os
from pathlib import Path

import torch


class CheckpointStore:
    """One folder, one state file, replaced atomically.

    The new state is written beside the old one and takes its name only once it is on disk, so
    there is always one complete checkpoint. Files hold tensors and plain data and are read with
    ``weights_only``: loading runs no code.

    Args:
        folder: Where the state file lives.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.journal = self.folder / "replay"
        self._file = self.folder / "state.pt"

    @property
    def exists(self) -> bool:
        """Whether there is something to resume from."""
        return self._file.is_file()

    def save(self, state: dict) -> None:
        """Write ``state``, then let it replace the previous one."""
        self.folder.mkdir(parents=True, exist_ok=True)
        fresh = self._file.with_suffix(".tmp")
        with fresh.open("wb") as file:
            torch.save(state, file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(fresh, self._file)

    def load(self) -> dict:
        """Read the last state into the memory of the CPU, whatever device it was saved from.

        Raises:
            FileNotFoundError: If there is none.
        """
        if not self.exists:
            raise FileNotFoundError(f"no checkpoint at {self._file}")
        return torch.load(self._file, map_location="cpu", weights_only=True)
