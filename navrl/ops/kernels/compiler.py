"""How kernels are compiled, cached on disk and given their threads."""

import functools
import hashlib
import importlib
import logging
import os
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import numba
import torch
from torch import Tensor

LOG = logging.getLogger(__name__)
_OPS = Path(__file__).parents[1]


def scalar(function: Callable) -> Callable:
    """Compile a small function that kernels call, those for CUDA too: numba compiles it anew."""
    return numba.njit(error_model="numpy")(function)


def reordering_scalar(function: Callable) -> Callable:
    """:func:`scalar` whose sums may be taken in any order, as vector instructions take them."""
    return numba.njit(error_model="numpy", fastmath={"reassoc", "contract"})(function)


def kernel(function: Callable) -> Callable:
    """Compile a loop over worlds (``numba.prange``) at its first call and cache it on disk.

    The kernel runs on as many threads as torch does (``torch.set_num_threads``,
    ``OMP_NUM_THREADS``), so one setting governs both and workers of ``ParallelEnv`` stay on one.
    A single thread runs the loop in place: no hand-over to a worker, safe in any thread and after
    any fork.

    Arguments are tensors, arrays and numbers; the first one is a tensor or an array. With tensors
    on a CUDA device the kernel of the same module and name in :mod:`navrl.ops.kernels.cuda` runs.
    """
    dispatchers = {}

    @functools.wraps(function)
    def launch(*arguments):
        if runs_on_cuda(arguments[0]):
            return _cuda_form(function)(*arguments)
        arguments = [as_array(argument) for argument in arguments]
        num_threads = min(torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS)
        is_parallel = num_threads > 1
        if is_parallel not in dispatchers:
            dispatchers[is_parallel] = _dispatcher(function, is_parallel)
        if not is_parallel:
            return dispatchers[False](*arguments)
        with _POOL:
            if numba.get_num_threads() != num_threads:
                numba.set_num_threads(num_threads)
            return dispatchers[True](*arguments)

    return launch


def runs_on_cuda(argument: object) -> bool:
    """Return whether a kernel with this argument is one for CUDA."""
    return isinstance(argument, Tensor) and argument.is_cuda


def as_array(argument: object) -> object:
    """Return the numpy view of a tensor, everything else as it is."""
    return (
        argument.numpy(force=argument.requires_grad) if isinstance(argument, Tensor) else argument
    )


@functools.cache
def _cuda_form(function: Callable) -> Callable:
    package, _, module = function.__module__.rpartition(".")
    return getattr(importlib.import_module(f"{package}.cuda.{module}"), function.__name__)


def _dispatcher(function: Callable, is_parallel: bool) -> Callable:
    """Prepare one form of a CPU kernel."""
    jit = numba.njit(parallel=is_parallel, cache=True, error_model="numpy")
    return cached(function, jit, "parallel" if is_parallel else "serial")


def cached(function: Callable, jit: Callable, form: str) -> Callable:
    """Compile a kernel by ``jit`` with its code on disk; say so if it is yet to be compiled."""
    directory = Path(cache_directory()) / form
    configured, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(directory)
    try:  # numba reads the directory once, here
        dispatcher = jit(function)
    finally:
        numba.config.CACHE_DIR = configured
    if not any(directory.rglob(f"*.{function.__name__}-*.nbi")):
        LOG.warning("compiling %s once, some seconds; kept in %s", function.__name__, directory)
    return dispatcher


class _Pool:
    """Numba's threads, one launch at a time.

    Numba's own pool ("workqueue") survives a fork, which GNU OpenMP does not (the child is killed),
    but aborts the process when two Python threads launch at once; hence a lock, new in each child.
    """

    def __init__(self) -> None:
        if numba.config.THREADING_LAYER == "default":  # respect who has chosen
            numba.config.THREADING_LAYER = "workqueue"
        self._lock = threading.Lock()
        if hasattr(os, "register_at_fork"):  # not on Windows
            os.register_at_fork(after_in_child=self._renew)

    def _renew(self) -> None:
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


_POOL = _Pool()


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
