"""On-disk cache of compiled kernels in private folders, with a checksum for each file."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import os
import pickle
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numba
from numba.core.caching import Cache
from numba.core.serialize import dumps

from navrl.files import explain_os_error, replacing
from navrl.ops.kernels.compile_progress import PROGRESS

if sys.platform != "win32":  # there, processes that start at once compile the same kernel
    import fcntl

LOG = logging.getLogger(__name__)
_OPS = Path(__file__).parents[1]
_CHECKSUM_BYTES = hashlib.sha256().digest_size
_LONGEST_COMPILE = 300.0  # s; after it a process compiles what another one is compiling


class KernelFiles:
    """Cache files of one kernel, one per signature; replaces the index and files of Numba.

    A kernel file is executed, so a damaged file is not loaded; the kernel is compiled again and the
    file replaced. The file name is a hash of everything the code depends on, so processes that
    compile at the same time cannot mix up the files of two signatures. If another process is
    compiling the same signature, :meth:`load` waits for its file; the lock ends with the process.

    Args:
        folder: Folder of the files.
        name: Prefix of the file names.
        stamp: Modification stamp of the kernel's source.
    """

    def __init__(self, folder: str | Path, name: str, stamp: object) -> None:
        self._folder, self._name = Path(folder), name
        self._versions = (numba.__version__, stamp)
        self._locks: dict[Path, int] = {}

    def load(self, key: object) -> object | None:
        """Return the data saved under ``key``; ``None`` if this process must compile it."""
        file = self._file(key)
        data = self._read(file)
        if data is None and self._lock(file):  # another process was compiling
            data = self._read(file)
        if data is not None:
            self._unlock(file)
        return data

    def _read(self, file: Path) -> object | None:
        try:
            content = file.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            LOG.warning("%s; the kernel is compiled again", explain_os_error(error))
            return None
        checksum, code = content[:_CHECKSUM_BYTES], content[_CHECKSUM_BYTES:]
        if hashlib.sha256(code).digest() != checksum:
            LOG.warning("%s: damaged; the kernel is compiled again", file)
            return None
        return pickle.loads(code)

    def save(self, key: object, data: object) -> None:
        """Save ``data`` under ``key``; a failure is logged and the kernel runs uncached."""
        PROGRESS.end()
        code, file = dumps(data), self._file(key)
        try:
            with replacing(file) as stream:
                stream.write(hashlib.sha256(code).digest() + code)
        except OSError as error:
            LOG.warning("a compiled kernel is not saved: %s", explain_os_error(error))
        finally:
            self._unlock(file)

    def flush(self) -> None:
        """Remove all files of the kernel."""
        for file in self._folder.glob(f"{self._name}.*.nbc"):
            file.unlink(missing_ok=True)

    def _lock(self, file: Path) -> bool:
        """Take the lock of a file until it is saved; return whether another process had it."""
        if sys.platform == "win32" or file in self._locks:
            return False
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            lock = os.open(file.with_suffix(".lock"), os.O_CREAT | os.O_RDWR, 0o600)
        except OSError:  # :meth:`save` reports it
            return False
        self._locks[file], start = lock, time.monotonic()
        waited = False
        while time.monotonic() < start + _LONGEST_COMPILE:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                waited = True
                time.sleep(0.05)
            except OSError:  # a file system without locks
                break
        return waited

    def _unlock(self, file: Path) -> None:
        lock = self._locks.pop(file, None)
        if lock is not None:
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(lock, fcntl.LOCK_UN)  # of copies in forked processes too
            os.close(lock)

    def _file(self, key: object) -> Path:
        whole = hashlib.sha256(repr((self._versions, key)).encode()).hexdigest()
        return self._folder / f"{self._name}.{whole[:16]}.nbc"


def use_checked_files(dispatcher: Callable) -> None:
    """Replace the on-disk cache of a Numba dispatcher by :class:`KernelFiles`."""
    cache = getattr(dispatcher, "_cache", None)
    if isinstance(cache, Cache):  # the CUDA simulator of Numba has none
        stamp = cache._impl.locator.get_source_stamp()
        files = KernelFiles(cache.cache_path, cache._impl.filename_base, stamp)
        # Numba annotates its own class; the cache calls only what KernelFiles has, too.
        cache._cache_file = files  # pyright: ignore[reportAttributeAccessIssue]


@functools.cache
def cache_directory() -> str:
    """Return the cache folder of the current kernel sources; create it if it is missing.

    Numba detects a change of a kernel's own file, but not of a function that it calls from another
    file; therefore the folder's name is a hash of all sources below ``navrl/ops``.

    A folder that another user could write to is not used, because its files are executed.
    """
    digest = hashlib.sha256()
    for path in sorted(_OPS.rglob("*.py")):
        digest.update(path.read_bytes())
    name = digest.hexdigest()[:16]
    cache_home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    shared = Path(tempfile.gettempdir()) / f"navrl-kernels-{_user()}"
    chains = [[cache_home / "navrl" / "kernels" / name], [shared, shared / name]]
    if os.environ.get("NUMBA_CACHE_DIR"):
        chains.insert(0, [Path(os.environ["NUMBA_CACHE_DIR"]) / name])
    for chain in chains:
        if _is_usable(chain):
            return str(chain[-1])
    return tempfile.mkdtemp(prefix="navrl-kernels-")


def _is_usable(chain: list[Path]) -> bool:
    """Create nested folders; return whether all of them are private and writable."""
    try:
        for folder in chain:
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
            if not _is_private(folder):
                LOG.warning("%s: writable by another user; kernels are cached elsewhere", folder)
                return False
        with tempfile.TemporaryFile(dir=chain[-1]):
            return True
    except OSError:
        return False


def _is_private(folder: Path) -> bool:
    """Return whether a folder is not a link and writable only by this user (or root)."""
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode):
        return False
    if not hasattr(os, "getuid"):  # Windows: temporary folders belong to the user
        return True
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return status.st_uid in (os.getuid(), 0) and not others


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"
