"""Replay buffer of network inputs with an on-disk journal for resuming."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer

from navrl import keys
from navrl.files import replacing_path
from navrl.ops.backend import find_device
from navrl.training.checkpoint import ADVICE, CheckpointError, damaged
from navrl.training.n_step import NStepReturn

_DTYPES = {"float16": torch.float16, "float32": torch.float32}
_OUTCOME = ("reward", "done", "terminated")


class Compact:
    """Reduce transitions to the entries that learning needs, for storage and transfer.

    Args:
        observation_keys: Keys that the networks read.
        storage: ``"float16"`` or ``"float32"`` for the observation.

    Raises:
        ValueError: If ``storage`` is unknown.
    """

    def __init__(self, observation_keys: Sequence[str], storage: str = "float16") -> None:
        if storage not in _DTYPES:
            raise ValueError(f"storage={storage!r}: must be one of {sorted(_DTYPES)}")
        self.observation_keys, self._dtype = list(observation_keys), _DTYPES[storage]

    def __call__(self, transitions: TensorDictBase) -> TensorDict:
        """Return new transitions of the same shape with observations, action and end flags only."""
        following, shape = transitions.get("next"), transitions.batch_size
        after = {**self._observation(following), **{k: following.get(k) for k in _OUTCOME}}
        return TensorDict(
            {
                **self._observation(transitions),
                keys.ACTION: transitions.get(keys.ACTION),
                "next": TensorDict(after, shape),
            },
            shape,
        )

    def _observation(self, tensordict: TensorDictBase) -> dict[str, torch.Tensor]:
        return {key: tensordict.get(key).to(self._dtype) for key in self.observation_keys}


class Replay:
    """TorchRL replay buffer of network inputs.

    A transition contains the observation keys at t and t+1, the normalized action, the reward and
    the two end flags. With the paper's inputs (490 numbers per state) it takes 1,974 bytes in
    float16 and 3,934 in float32, so 2,000,000 transitions take 3.9 or 7.9 GB. Memory is allocated
    as the buffer fills.

    Args:
        observation_keys: Keys that the networks read.
        capacity: Largest number of stored transitions; the oldest are overwritten.
        batch_size: Transitions per batch.
        storage: ``"float16"`` or ``"float32"`` for the observation. Inputs are scaled to [-1, 1],
            where the error of float16 is at most 0.9 mm at 3.5 m, a thirtieth of the sensor noise.
        num_steps: Steps per transition; see :class:`navrl.training.n_step.NStepReturn`.
        gamma: Discount factor per step, used if ``num_steps`` > 1.
        device: Device of stored transitions and batches; transitions are copied to it.

    Raises:
        ValueError: If a size is not positive or ``storage`` is unknown.

    Reference:
        Paper Sec. IV-B: a buffer of 2,000,000.
    """

    def __init__(
        self,
        observation_keys: Sequence[str],
        capacity: int = 2_000_000,
        batch_size: int = 256,
        storage: str = "float16",
        num_steps: int = 1,
        gamma: float = 0.98,
        device: torch.device | str = "cpu",
    ) -> None:
        if capacity <= 0 or batch_size <= 0:
            raise ValueError(f"capacity={capacity}, batch_size={batch_size}: must be > 0")
        self.capacity, self.batch_size = capacity, batch_size
        self._compact = Compact(observation_keys, storage)
        self._n_step = partial(NStepReturn, num_steps, gamma)
        self._streams: dict[int, NStepReturn] = {0: self._n_step()}
        self.device = find_device(device)
        self._buffer = ReplayBuffer(storage=LazyTensorStorage(capacity, device=self.device))
        self.written = 0
        self._journaled = 0
        self._chunks: list[tuple[int, int, str]] = []  # first row, end row (exclusive), SHA-256

    def __len__(self) -> int:
        return len(self._buffer)

    def extend(self, transitions: TensorDictBase, stream: int = 0) -> None:
        """Add one step of ``[M]`` worlds of an environment; unused keys are dropped.

        Args:
            transitions: Transitions; row i is the same world in all steps of a stream.
            stream: Index of the group of worlds, for n-step returns.
        """
        if stream not in self._streams:
            self._streams[stream] = self._n_step()
        compact = self._compact(transitions)
        if self.device.type != "cpu":
            # The device is cleared so that TorchRL creates its indices on the CPU, where it reads
            # them.
            compact = compact.to(self.device, non_blocking=True).clear_device_()
        complete = self._streams[stream](compact)
        if complete is not None:
            self._buffer.extend(complete)
            self.written += len(complete)

    def sample(self, count: int = 1) -> TensorDictBase:
        """Draw ``[count, batch_size]`` transitions uniformly, observations in float32."""
        rows = self._buffer.sample(count * self.batch_size)
        shape = (count, self.batch_size)
        return rows.apply(lambda value: _float(value).unflatten(0, shape), batch_size=shape)

    def discard_pending(self) -> None:
        """Discard pending steps of n-step returns whose episodes are not continued."""
        self._streams = {}

    # --- journal ---------------------------------------------------------------------------------

    def save(self, folder: Path) -> dict[str, object]:
        """Append the transitions since the last call to the journal.

        The cost of a checkpoint is therefore that of the new transitions. Chunks with only
        overwritten rows are deleted later by :meth:`prune`, because the previous checkpoint may
        still need them.

        Args:
            folder: Journal folder; each call writes one file.

        Returns:
            State for :meth:`load` in addition to the folder, with the SHA-256 of each chunk.

        Raises:
            OSError: If writing fails; files of previous calls are retained.
        """
        start = max(self._journaled, self.written - self.capacity)
        if self.written > start:
            rows = torch.arange(start, self.written) % self.capacity
            flat = self._buffer.storage[rows].cpu().flatten_keys(".").to_dict()
            tensors = {k: v.contiguous() for k, v in flat.items()}
            digest = _save_chunk(tensors, self._file(folder, start))
            self._chunks.append((start, self.written, digest))
        self._journaled = self.written
        oldest = self.written - self.capacity
        self._chunks = [chunk for chunk in self._chunks if chunk[1] > oldest]
        return {
            "written": self.written,
            "chunks": [list(chunk) for chunk in self._chunks],
            "streams": {stream: fold.state_dict() for stream, fold in self._streams.items()},
        }

    def prune(self, folder: Path) -> None:
        """Delete journal files that are not part of the last :meth:`save`."""
        kept = {self._file(folder, start) for start, *_ in self._chunks}
        for file in folder.glob("*chunk_*"):  # includes partial files of a killed process
            if file not in kept:
                file.unlink()

    def load(self, folder: Path, state: Mapping[str, Any]) -> None:
        """Restore the buffer with all rows at their original positions.

        Raises:
            CheckpointError: If a chunk is missing or damaged.
        """
        self.written = self._journaled = int(state["written"])
        for stream, steps in state.get("streams", {}).items():
            self._streams[stream] = self._n_step()
            self._streams[stream].load_state_dict(steps, self.device)
        # Older journals list chunks without checksums.
        self._chunks = [(start, end, *(digest or [""])) for start, end, *digest in state["chunks"]]
        storage = self._buffer.storage
        for start, end, digest in self._chunks:
            tensors = _load_chunk(self._file(folder, start), digest)
            flat = TensorDict(tensors, [end - start]).to(self.device)
            storage.set(torch.arange(start, end) % self.capacity, flat.unflatten_keys("."))
        self._buffer.writer.load_state_dict({"_cursor": self.written % self.capacity})
        self.prune(folder)

    @staticmethod
    def _file(folder: Path, start: int) -> Path:
        return folder / f"chunk_{start:012d}.safetensors"


def _float(value: torch.Tensor) -> torch.Tensor:
    return value.float() if value.is_floating_point() else value


def _save_chunk(tensors: Mapping[str, torch.Tensor], file: Path) -> str:
    """Write a chunk atomically and synchronize it to disk; return its SHA-256."""
    with replacing_path(file) as fresh:
        try:
            save_file(dict(tensors), fresh)
        except SafetensorError as error:  # hides the error of the operating system
            raise OSError(f"{file}: {error}") from error
        with fresh.open("rb") as written:
            os.fsync(written.fileno())
            return hashlib.file_digest(written, "sha256").hexdigest()


def _load_chunk(file: Path, digest: str) -> dict[str, torch.Tensor]:
    """Read a chunk and verify its SHA-256; an empty digest is not verified."""
    if not file.is_file():
        raise CheckpointError(f"{file}: missing, a part of the replay journal; {ADVICE}")
    with file.open("rb") as stored:
        if digest and hashlib.file_digest(stored, "sha256").hexdigest() != digest:
            raise damaged(file)
    try:
        return load_file(file)
    except SafetensorError as error:
        raise damaged(file) from error
