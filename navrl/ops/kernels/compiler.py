"""How kernels are compiled, cached on disk and given their threads."""

import functools
import importlib
import logging
from collections.abc import Callable
from pathlib import Path

import numba
from torch import Tensor

from navrl.ops.kernels.cache import cache_directory, use_checked_files
from navrl.ops.kernels.threads import run_rows

LOG = logging.getLogger(__name__)


def scalar(function: Callable) -> Callable:
    """Compile a small function that kernels call, those for CUDA too: numba compiles it anew."""
    return numba.njit(error_model="numpy")(function)


def reordering_scalar(function: Callable) -> Callable:
    """:func:`scalar` whose sums may be taken in any order, as vector instructions take them."""
    return numba.njit(error_model="numpy", fastmath={"reassoc", "contract"})(function)


def kernel(function: Callable) -> Callable:
    """Compile a loop over rows, at its first call, and cache it on disk.

    The function's first parameter is ``rows``, the (first, last + 1) that it is to work on; who
    calls the kernel leaves it out, and all rows of the first argument are shared among threads
    (:mod:`navrl.ops.kernels.threads`).

    Arguments are tensors, arrays and numbers; the first one is a tensor or an array. With tensors
    on a CUDA device the kernel of the same module and name in :mod:`navrl.ops.kernels.cuda` runs.
    """

    @functools.cache
    def compiled() -> Callable:
        jit = numba.njit(nogil=True, cache=True, error_model="numpy")
        return cached(function, jit, "cpu")

    @functools.wraps(function)
    def launch(*arguments):
        if runs_on_cuda(arguments[0]):
            return _cuda_form(function)(*arguments)
        arguments = tuple(as_array(argument) for argument in arguments)
        return run_rows(compiled(), arguments[0].shape[0], arguments)

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


def cached(function: Callable, jit: Callable, form: str) -> Callable:
    """Compile a kernel by ``jit`` with its code on disk; say so if it is yet to be compiled."""
    directory = Path(cache_directory()) / form
    configured, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(directory)
    try:  # numba reads the directory once, here
        dispatcher = jit(function)
    finally:
        numba.config.CACHE_DIR = configured
    use_checked_files(dispatcher)
    if not any(directory.rglob(f"*.{function.__name__}-*.nbc")):
        LOG.warning("compiling %s once, some seconds; kept in %s", function.__name__, directory)
    return dispatcher
