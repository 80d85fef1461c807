"""How CUDA kernels are compiled, cached on disk and launched."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numba
import torch
from numba import cuda
from torch import Tensor

from navrl.ops.kernels.compiler import as_array, cached

numba.config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # few worlds are what evaluation plays in

ROW_THREADS = 32  # of a block whose threads have a row each: small, so that all processors get some


class CudaKernel:
    """What one CUDA thread does, to be launched with a thread or a block for each row.

    A row is one of the first argument's. A launch is queued on torch's current stream, between
    torch's own operations: nothing waits for it.

    Args:
        function: Of the thread; its arguments are tensors on the device and numbers.
        threads: Of a block.
        has_block_per_row: Whether each row has a block of threads, or one thread.
    """

    def __init__(self, function: Callable, threads: int, has_block_per_row: bool) -> None:
        functools.update_wrapper(self, function)
        self.function, self.threads = function, threads
        self.has_block_per_row = has_block_per_row

    def __call__(self, *arguments: object) -> None:
        rows = arguments[0].shape[0]
        if rows == 0:
            return
        blocks = rows if self.has_block_per_row else -(-rows // self.threads)
        launch = self._dispatcher[blocks, self.threads, _stream(arguments[0])]
        launch(*(_on_device(argument) for argument in arguments))

    @functools.cached_property
    def _dispatcher(self) -> Callable:
        return cached(self.function, cuda.jit(cache=True), "cuda")


def thread_per_row(function: Callable) -> CudaKernel:
    """Make a kernel of which each thread takes the row ``cuda.grid(1)``, if there is one."""
    return CudaKernel(function, ROW_THREADS, has_block_per_row=False)


def block_per_row(threads: int) -> Callable[[Callable], CudaKernel]:
    """Make a kernel of which each block takes the row ``cuda.blockIdx.x``."""
    return functools.partial(CudaKernel, threads=threads, has_block_per_row=True)


def _stream(argument: object) -> object:
    """Return torch's current stream; 0 is the default one, and the simulator's."""
    is_simulated = not (isinstance(argument, Tensor) and argument.is_cuda)
    handle = 0 if is_simulated else torch.cuda.current_stream(argument.device).cuda_stream
    return cuda.external_stream(handle) if handle else 0


def _on_device(argument: object) -> object:
    if isinstance(argument, Tensor) and argument.is_cuda:
        return cuda.as_cuda_array(argument.detach(), sync=False)
    return as_array(argument)
