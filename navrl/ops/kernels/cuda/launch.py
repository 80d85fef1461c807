"""Compilation, on-disk caching and launch of CUDA kernels."""

from __future__ import annotations

import functools
from collections.abc import Callable

import torch
from numba import cuda
from torch import Tensor

from navrl.ops.kernels.compiler import SETTINGS, as_array, cached

SETTINGS.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # evaluation runs few worlds, so occupancy is low

ROW_THREADS = 32  # threads per block with one row per thread; small to use all multiprocessors


class CudaKernel:
    """CUDA kernel launched with one thread or one block per row of its first argument.

    A launch is queued on the current stream of torch, in order with torch's operations, without
    synchronization with the host.

    Args:
        function: Body of a thread; its arguments are tensors on the device and numbers.
        threads: Number of threads per block.
        has_block_per_row: Whether each row is processed by a block instead of a single thread.
    """

    def __init__(self, function: Callable, threads: int, has_block_per_row: bool) -> None:
        functools.update_wrapper(self, function)
        self.function, self.threads = function, threads
        self.has_block_per_row = has_block_per_row

    def __call__(self, first: Tensor, *others: object) -> None:
        rows = first.shape[0]
        if rows == 0:
            return
        blocks = rows if self.has_block_per_row else -(-rows // self.threads)
        launch = self._dispatcher[blocks, self.threads, _stream(first)]
        launch(*(_on_device(argument) for argument in (first, *others)))

    @functools.cached_property
    def _dispatcher(self) -> Callable:
        return cached(self.function, cuda.jit(cache=True), "cuda")


def thread_per_row(function: Callable) -> CudaKernel:
    """Return a kernel whose threads each process the row ``cuda.grid(1)``, if it exists."""
    return CudaKernel(function, ROW_THREADS, has_block_per_row=False)


def block_per_row(threads: int) -> Callable[[Callable], CudaKernel]:
    """Return a kernel whose blocks each process the row ``cuda.blockIdx.x``."""
    return functools.partial(CudaKernel, threads=threads, has_block_per_row=True)


def _stream(argument: Tensor) -> object:
    """Return the current stream of torch; 0 for the default stream and the CUDA simulator."""
    is_simulated = not (isinstance(argument, Tensor) and argument.is_cuda)
    handle = 0 if is_simulated else torch.cuda.current_stream(argument.device).cuda_stream
    return cuda.external_stream(handle) if handle else 0


def _on_device(argument: object) -> object:
    if isinstance(argument, Tensor) and argument.is_cuda:
        return cuda.as_cuda_array(argument.detach(), sync=False)
    return as_array(argument)
