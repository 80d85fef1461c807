"""Lock of a results folder by the operating system, for one process at a time."""

from __future__ import annotations

import fcntl
import logging
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

log = logging.getLogger(__name__)

_FILE = ".lock"
_held: set[int] = set()  # descriptors; a forked child closes its copies, which would hold the lock


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a results folder, which is created if missing.

    The operating system releases the lock when the process ends, for any reason.

    Args:
        folder: Run folder or folder of an evaluation.

    Raises:
        ValueError: If another process holds it; the message names the process.
        OSError: If the lock file is a link, or cannot be created.
    """
    folder.mkdir(parents=True, exist_ok=True)
    # A link in a folder from others could point to any file of the user.
    descriptor = os.open(folder / _FILE, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
    try:
        _lock(descriptor, folder)
        _held.add(descriptor)
        now = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
        os.ftruncate(descriptor, 0)
        os.pwrite(
            descriptor, f"process {os.getpid()} on {socket.gethostname()} since {now}".encode(), 0
        )
        yield
    finally:
        _held.discard(descriptor)
        os.close(descriptor)


def new_folder(folder: Path) -> Path:
    """Create a new folder: ``folder``, or ``folder_2``, ``folder_3``, ... if it exists."""
    for number in count(1):
        candidate = folder if number == 1 else folder.with_name(f"{folder.name}_{number}")
        try:
            candidate.mkdir(parents=True)
        except FileExistsError:
            continue
        return candidate


def _lock(descriptor: int, folder: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.pread(descriptor, 200, 0).decode(errors="replace") or "another process"
        raise ValueError(
            f"{folder}: in use by {holder}; wait until it ends, or choose another hydra.run.dir or "
            "hydra.sweep.dir"
        ) from None
    except OSError as error:  # a file system without locks
        log.warning("%s: not locked (%s); start only one process there", folder, error.strerror)


def _close_inherited() -> None:
    for descriptor in _held:
        os.close(descriptor)
    _held.clear()


os.register_at_fork(after_in_child=_close_inherited)
