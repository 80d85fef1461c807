"""Cooperation of the threads of one block: column ranges and reductions."""

import torch
from numba import cuda
from torch import Tensor

BLOCKS_PER_PROCESSOR = 8  # enough concurrent blocks to keep a multiprocessor busy


@cuda.jit(device=True)
def own_columns(count):
    """Return the contiguous range (first, stop) of columns of this thread."""
    share = (count + cuda.blockDim.x - 1) // cuda.blockDim.x
    first = min(cuda.threadIdx.x * share, count)
    return first, min(first + share, count)


@cuda.jit(device=True)
def repeat_columns(rows, count, first, stop):
    """Copy the columns ``first .. stop - 1`` of ``count`` to a second and a third copy."""
    for row in range(rows.shape[0]):
        for column in range(first, stop):
            rows[row, column + count] = rows[row, column]
            rows[row, column + 2 * count] = rows[row, column]


@cuda.jit(device=True)
def add_up(partials):
    """Sum the rows of ``partials`` [threads, sums], one per thread, into the first row.

    The order of additions is fixed, so that results are reproducible.
    """
    lane, width = cuda.threadIdx.x, cuda.blockDim.x
    cuda.syncthreads()
    while width > 1:
        half = (width + 1) // 2
        if lane + half < width:
            for column in range(partials.shape[1]):
                partials[lane, column] += partials[lane + half, column]
        cuda.syncthreads()
        width = half


def num_blocks(rows: Tensor) -> int:
    """Return the number of blocks that iterate over the rows, each with its own scratch memory."""
    if not rows.is_cuda:  # the simulator
        return min(len(rows), 2)
    processors = torch.cuda.get_device_properties(rows.device).multi_processor_count
    return min(len(rows), BLOCKS_PER_PROCESSOR * processors)
