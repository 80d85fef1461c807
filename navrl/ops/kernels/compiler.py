"""Decorators that compile kernels, cache them on disk and run them on several threads."""

import functools
import importlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config
from torch import Tensor

from navrl.ops.kernels.cache import cache_directory, use_checked_files
from navrl.ops.kernels.compile_progress import PROGRESS, is_cached
from navrl.ops.kernels.threads import run_rows

SETTINGS: Any = config  # Numba sets its attributes at run time
LOG = logging.getLogger(__name__)


def scalar(function: Callable) -> Callable:
    """Compile a small function for use in kernels; Numba compiles it again for CUDA kernels."""
    return numba.njit(error_model="numpy")(function)


def reordering_scalar(function: Callable) -> Callable:
    """Compile like :func:`scalar`, but allow reordered sums so that loops can be vectorized."""
    return numba.njit(error_model="numpy", fastmath={"reassoc", "contract"})(function)


def unordered_scalar(function: Callable) -> Callable:
    """Compile like :func:`scalar` for numbers without NaN, so that maxima can be vectorized."""
    return numba.njit(error_model="numpy", fastmath={"nnan", "nsz", "reassoc"})(function)


def kernel(function: Callable) -> Callable:
    """Compile a loop over rows at its first call and cache it on disk.

    The first parameter of the function is ``rows``, the range (first, last + 1) to process. Callers
    omit it: all rows of the first argument are distributed over threads
    (:mod:`navrl.ops.kernels.threads`).

    Arguments are tensors, arrays and numbers; the first one is a tensor or an array. For tensors on
    a CUDA device the kernel of the same module and name in :mod:`navrl.ops.kernels.cuda` runs.
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
    """Return whether a kernel call with this argument runs on CUDA."""
    return isinstance(argument, Tensor) and argument.is_cuda


def as_array(argument: object) -> object:
    """Return the NumPy view of a tensor; other values are returned unchanged."""
    return (
        argument.numpy(force=argument.requires_grad) if isinstance(argument, Tensor) else argument
    )


@functools.cache
def _cuda_form(function: Callable) -> Callable:
    package, _, module = function.__module__.rpartition(".")
    return getattr(importlib.import_module(f"{package}.cuda.{module}"), function.__name__)


def cached(function: Callable, jit: Callable, form: str) -> Callable:
    """Compile a kernel with ``jit`` and cache its code; log a warning before a first compile."""
    directory = Path(cache_directory()) / form
    configured, SETTINGS.CACHE_DIR = SETTINGS.CACHE_DIR, str(directory)
    try:  # Numba reads the directory only when the dispatcher is created
        dispatcher = jit(function)
    finally:
        SETTINGS.CACHE_DIR = configured
    use_checked_files(dispatcher)
    if not is_cached(function.__name__, directory):
        LOG.warning("%s", PROGRESS.begin(function.__name__, directory))
    return dispatcher
