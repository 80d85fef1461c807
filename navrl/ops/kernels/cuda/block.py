"""What the threads of one block do together: sharing out columns and adding up."""

import torch
from numba import cuda
from torch import Tensor

BLOCKS_PER_PROCESSOR = 8  # so many scratch rows are enough to keep a multiprocessor busy


@cuda.jit(device=True)
def own_columns(count):
    """Return first and end of the columns, next to each other, that are this thread's own."""
    share = (count + cuda.blockDim.x - 1) // cuda.blockDim.x
    first = min(cuda.threadIdx.x * share, count)
    return first, min(first + share, count)


@cuda.jit(device=True)
def repeat_columns(rows, count, first, stop):
    """Copy the columns ``first .. stop - 1`` of ``count`` to a second and a third round."""
    for row in range(rows.shape[0]):
        for column in range(first, stop):
            rows[row, column + count] = rows[row, column]
            rows[row, column + 2 * count] = rows[row, column]


@cuda.jit(device=True)
def add_up(partials):
    """Add up the rows of ``partials`` [threads, sums], each thread's own, into the first.

    Always in the same order, so that a result is the same each time.
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
    """Return how many blocks are to take the rows by turns, each with scratch memory of its own."""
    if not rows.is_cuda:  # the simulator
        return min(len(rows), 2)
    processors = torch.cuda.get_device_properties(rows.device).multi_processor_count
    return min(len(rows), BLOCKS_PER_PROCESSOR * processors)
