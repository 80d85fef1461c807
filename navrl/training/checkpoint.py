"""Checkpoints that survive a ``kill -9``, a power loss and a full disk, and detect damage."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from navrl.files import replacing

_SEAL = b"navrl-sha256"  # before the digest, at the end of a state file
_DIGEST_BYTES = 32
_ZIP_END = b"PK\x05\x06"  # begins the last 22 bytes of what torch.save writes
_ZIP_END_BYTES = 22
ADVICE = "put it back from a copy of the run, or start a new run"


class CheckpointError(ValueError):
    """A checkpoint is missing a part or is damaged; the message says what to do."""


class CheckpointStore:
    """One folder, one state file, replaced atomically.

    The new state is written beside the old one and takes its name only once it is on disk, so
    there is always one complete checkpoint. The file ends in the SHA-256 of what is before it;
    older files without one are read too. Files hold tensors and plain data and are read with
    ``weights_only``: loading runs no code.

    Args:
        folder: Where the state file is stored.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.journal = self.folder / "replay"
        self._file = self.folder / "state.pt"

    @property
    def exists(self) -> bool:
        """Whether there is something to resume from."""
        return self._file.is_file()

    def check_new(self, log: Path) -> None:
        """Verify that a run without a state file has not lost it.

        Args:
            log: File that a run writes only after its first checkpoint.

        Raises:
            CheckpointError: If the log or the replay journal is there.
        """
        if not self.exists and (log.is_file() or any(self.journal.glob("chunk_*"))):
            raise CheckpointError(
                f"{self._file}: missing, though the run has saved before; {ADVICE} (to train again "
                f"from frame 0 in this folder, delete {self.folder} and {log})"
            )

    def save(self, state: dict) -> None:
        """Write ``state``, then let it replace the previous one.

        Raises:
            OSError: If writing fails; the previous state stays.
        """
        buffer = io.BytesIO()
        torch.save(state, buffer)
        content = buffer.getbuffer()
        with replacing(self._file) as file:
            file.write(content)
            file.write(_SEAL + hashlib.sha256(content).digest())

    def load(self) -> dict:
        """Read the last state into the memory of the CPU, whatever device it was saved from.

        Raises:
            FileNotFoundError: If there is none.
            CheckpointError: If the file is damaged.
        """
        if not self.exists:
            raise FileNotFoundError(f"no checkpoint at {self._file}")
        for unfinished in self.folder.glob(".state.*"):  # what a kill left of a later one
            unfinished.unlink()
        content = memoryview(self._file.read_bytes())
        if not _is_whole(content):
            raise damaged(self._file)
        try:
            return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        except (
            Exception
        ) as error:  # torch raises RuntimeError, UnpicklingError, EOFError and others
            raise damaged(self._file) from error


@contextmanager
def resumable(run: Path) -> Iterator[None]:
    """Let an error of the operating system, e.g. a full disk, name what is safe and how to go on.

    Raises:
        OSError: If the block raises one.
    """
    try:
        yield
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        raise OSError(
            f"{place}{error.strerror or error}; what was saved before is complete, "
            f"navrl-train resume={run} continues from it"
        ) from error


def damaged(file: Path) -> CheckpointError:
    """Return the error for a file whose content is not what was written."""
    return CheckpointError(f"{file}: damaged, its checksum or format is wrong; {ADVICE}")


def _is_whole(content: memoryview) -> bool:
    """Return whether the digest at the end fits; a file without one must end as a ZIP file."""
    end = len(content) - len(_SEAL) - _DIGEST_BYTES
    if end > 0 and content[end : end + len(_SEAL)] == _SEAL:
        return hashlib.sha256(content[:end]).digest() == content[end + len(_SEAL) :]
    return content[-_ZIP_END_BYTES:][: len(_ZIP_END)] == _ZIP_END
