"""Atomic checkpoints with checksums, safe against ``kill -9``, power loss and a full disk."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import torch

from navrl.algos import Algorithm, NonFiniteUpdateError
from navrl.files import replacing

_SEAL = b"navrl-sha256"  # marker before the digest at the end of a state file
_DIGEST_BYTES = 32
_ZIP_END = b"PK\x05\x06"  # start of the last 22 bytes of a file of torch.save
_ZIP_END_BYTES = 22
ADVICE = "put it back from a copy of the run, or start a new run"


class CheckpointError(ValueError):
    """Error for an incomplete or damaged checkpoint; the message contains the remedy."""


class CheckpointStore:
    """Folder with one state file that is replaced atomically.

    A new state is written to a temporary file and renamed once it is on disk, so there is always
    one complete checkpoint. The file ends with the SHA-256 of its content; older files without a
    digest are accepted. Files contain tensors and plain data and are read with ``weights_only``, so
    loading does not execute code.

    Args:
        folder: Folder of the state file.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self.journal = self.folder / "replay"
        self._file = self.folder / "state.pt"

    @property
    def exists(self) -> bool:
        """Return whether there is a checkpoint to resume from."""
        return self._file.is_file()

    def check_new(self, log: Path) -> None:
        """Check that a run without a state file is new, i.e. its state file is not missing.

        Args:
            log: File that a run writes only after its first checkpoint.

        Raises:
            CheckpointError: If the log or the replay journal exists.
        """
        if not self.exists and (log.is_file() or any(self.journal.glob("chunk_*"))):
            raise CheckpointError(
                f"{self._file}: missing, although the run has saved before; {ADVICE} (to train "
                f"again from frame 0 in this folder, delete {self.folder} and {log})"
            )

    def save(self, state: dict) -> None:
        """Write ``state`` and replace the previous one.

        Raises:
            OSError: If writing fails; the previous state is retained.
        """
        buffer = io.BytesIO()
        torch.save(state, buffer)
        content = buffer.getbuffer()
        with replacing(self._file) as file:
            file.write(content)
            file.write(_SEAL + hashlib.sha256(content).digest())

    def load(self) -> dict:
        """Read the last state to CPU memory, independent of the device it was saved on.

        Raises:
            FileNotFoundError: If there is no checkpoint.
            CheckpointError: If the file is damaged.
        """
        if not self.exists:
            raise FileNotFoundError(f"no checkpoint at {self._file}")
        for unfinished in self.folder.glob(".state.*"):  # temporary files of a killed process
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
    """Add the state of the run and the command to resume to an ``OSError`` of the block.

    Raises:
        OSError: If the block raises one, e.g. for a full disk.
    """
    try:
        yield
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        raise OSError(
            f"{place}{error.strerror or error}; what was saved before is complete, "
            f"navrl-train resume={run} continues from it"
        ) from error


@contextmanager
def failures_saved(run: Path, algorithm: Algorithm) -> Iterator[None]:
    """Save the batch and the weights before a non-finite update of the block.

    Raises:
        NonFiniteUpdateError: If the block raises one; a note names the file in the run folder.
    """
    try:
        yield
    except NonFiniteUpdateError as error:
        file = run / "not_finite.pt"
        state = {"batch": error.batch.to_dict(), "algorithm": algorithm.state_dict()}
        with replacing(file) as stream:
            torch.save(state, stream)
        error.add_note(f"the batch and the weights before it are in {file}")
        raise


def random_state(device: torch.device) -> dict[str, torch.Tensor]:
    """Return the states of torch's random number generators, on the CPU and on ``device``."""
    state = {"rng": torch.get_rng_state()}
    if device.type == "cuda":
        state["device_rng"] = torch.cuda.get_rng_state(device)
    return state


def restore_random_state(state: Mapping[str, torch.Tensor], device: torch.device) -> None:
    """Restore what :func:`random_state` returned, possibly on another device."""
    torch.set_rng_state(state["rng"])
    if "device_rng" in state and device.type == "cuda":
        torch.cuda.set_rng_state(state["device_rng"], device)


def damaged(file: Path) -> CheckpointError:
    """Return the error for a file whose checksum or format is wrong."""
    return CheckpointError(f"{file}: damaged, its checksum or format is wrong; {ADVICE}")


def _is_whole(content: memoryview) -> bool:
    """Return whether the digest matches; a file without one must end like a ZIP file."""
    end = len(content) - len(_SEAL) - _DIGEST_BYTES
    if end > 0 and content[end : end + len(_SEAL)] == _SEAL:
        return hashlib.sha256(content[:end]).digest() == content[end + len(_SEAL) :]
    return content[-_ZIP_END_BYTES:][: len(_ZIP_END)] == _ZIP_END
