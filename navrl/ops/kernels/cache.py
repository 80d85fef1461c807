"""Where compiled kernels are kept: in folders of the user alone, each file with its checksum."""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import pickle
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path

import numba
from numba.core.caching import Cache
from numba.core.serialize import dumps

from navrl.files import explain_os_error, replacing

LOG = logging.getLogger(__name__)
_OPS = Path(__file__).parents[1]
_CHECKSUM_BYTES = hashlib.sha256().digest_size


class KernelFiles:
    """The files of one kernel, one for each signature, in place of numba's own index and files.

    A kernel file is code, so a damaged one must not be loaded: it is compiled again and replaced.
    As a file's name is made from all that its code depends on, processes that compile at the same
    time cannot exchange the files of two signatures.

    Args:
        folder: Of the files.
        name: What their names begin with.
        stamp: Of the kernel's source.
    """

    def __init__(self, folder: str | Path, name: str, stamp: object) -> None:
        self._folder, self._name = Path(folder), name
        self._versions = (numba.__version__, stamp)

    def load(self, key: object) -> object | None:
        """Return what was saved under ``key``; ``None`` if there is nothing that can be used."""
        file = self._file(key)
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
        """Save ``data`` under ``key``; a kernel that cannot be saved still runs."""
        code = dumps(data)
        try:
            with replacing(self._file(key)) as stream:
                stream.write(hashlib.sha256(code).digest() + code)
        except OSError as error:
            LOG.warning("a compiled kernel is not kept: %s", explain_os_error(error))

    def flush(self) -> None:
        """Remove all files of the kernel."""
        for file in self._folder.glob(f"{self._name}.*.nbc"):
            file.unlink(missing_ok=True)

    def _file(self, key: object) -> Path:
        whole = hashlib.sha256(repr((self._versions, key)).encode()).hexdigest()
        return self._folder / f"{self._name}.{whole[:16]}.nbc"


def use_checked_files(dispatcher: Callable) -> None:
    """Let a kernel that numba caches on disk use :class:`KernelFiles`."""
    cache = getattr(dispatcher, "_cache", None)
    if isinstance(cache, Cache):  # numba's simulation of CUDA has none
        stamp = cache._impl.locator.get_source_stamp()
        cache._cache_file = KernelFiles(cache.cache_path, cache._impl.filename_base, stamp)


@functools.cache
def cache_directory() -> str:
    """Return the folder of compiled kernels for exactly these sources, made if need be.

    Numba notices a change of a kernel's own file, but not of a function that it calls from another
    file; so the folder's name is a hash of all sources that kernels are made from.

    A folder that another user could write to is not used: its files would be run as code.
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
    """Make folders, each in the one before; return whether all are private and can be written."""
    try:
        for folder in chain:
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
            if not _is_private(folder):
                LOG.warning(
                    "%s: can be written by another user; kernels are kept elsewhere", folder
                )
                return False
        with tempfile.TemporaryFile(dir=chain[-1]):
            return True
    except OSError:
        return False


def _is_private(folder: Path) -> bool:
    """Return whether a folder is no link and can be written by this user (or root) alone."""
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode):
        return False
    if not hasattr(os, "getuid"):  # Windows: temporary folders are the user's own
        return True
    others = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return status.st_uid in (os.getuid(), 0) and not others


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"
