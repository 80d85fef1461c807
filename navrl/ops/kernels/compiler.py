"""How kernels are compiled, cached on disk and given their threads."""

import functools
import hashlib
import logging
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numba
import torch

LOG = logging.getLogger(__name__)
_OPS = Path(__file__).parents[1]


def scalar(function: Callable) -> Callable:
    """Compile a small function that kernels call; it is inlined into them."""
    return numba.njit(error_model="numpy")(function)


def kernel(function: Callable) -> Callable:
    """Compile a loop over worlds (``numba.prange``) at its first call and cache it on disk.

    The kernel runs on as many threads as torch does (``torch.set_num_threads``,
    ``OMP_NUM_THREADS``), so one setting governs both and workers of ``ParallelEnv`` stay on one.
    """
    directory = cache_directory()
    configured, numba.config.CACHE_DIR = numba.config.CACHE_DIR, directory
    try:  # numba reads the directory once, here
        dispatcher = numba.njit(parallel=True, cache=True, error_model="numpy")(function)
    finally:
        numba.config.CACHE_DIR = configured
    is_announced = False

    @functools.wraps(function)
    def launch(*arguments):
        nonlocal is_announced
        if not is_announced:
            is_announced = True
            if not any(Path(directory).rglob(f"*{function.__name__}-*.nbi")):
                LOG.warning(
                    "compiling %s for this CPU, some seconds, once; cached in %s",
                    function.__name__,
                    directory,
                )
        follow_torch_threads()
        return dispatcher(*arguments)

    launch.dispatcher = dispatcher
    return launch


def follow_torch_threads() -> None:
    """Let kernels use as many threads as torch does, within what numba started with."""
    wanted = min(torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS)
    if numba.get_num_threads() != wanted:
        numba.set_num_threads(wanted)


@functools.cache
def cache_directory() -> str:
    """Return the folder of compiled kernels for exactly these sources, made if need be.

    Numba notices a change of a kernel's own file, but not of a function that it calls from another
    file; so the folder's name is a hash of all sources that kernels are made from.
    """
    digest = hashlib.sha256()
    for path in sorted(_OPS.rglob("*.py")):
        digest.update(path.read_bytes())
    cache_home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    parents = [cache_home / "navrl" / "kernels", Path(tempfile.gettempdir()) / "navrl-kernels"]
    if os.environ.get("NUMBA_CACHE_DIR"):
        parents.insert(0, Path(os.environ["NUMBA_CACHE_DIR"]))
    for parent in parents:
        directory = parent / digest.hexdigest()[:16]
        try:
            directory.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=directory):
                return str(directory)
        except OSError:
            continue
    return tempfile.mkdtemp(prefix="navrl-kernels-")
