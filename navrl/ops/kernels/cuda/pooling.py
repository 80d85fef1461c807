"""Min-pooling: one block per scan, several bins per thread."""

from numba import cuda

from navrl.ops.kernels.cuda.launch import block_per_row
from navrl.ops.kernels.pooling import cleaned_range, write_bin

THREADS = 64


@block_per_row(THREADS)
def min_pool_kernel(ranges, directions, is_per_beam, limit, max_range, nearest, points, returns):
    """Pool the beams of each scan [S, beams] into bins, in the dtype of ``ranges``."""
    n, num_bins = cuda.blockIdx.x, nearest.shape[1]
    scan, size = ranges[n], ranges.shape[1] // num_bins
    for index in range(cuda.threadIdx.x, num_bins, cuda.blockDim.x):
        smallest = max_range
        for beam in range(index * size, (index + 1) * size):
            value = cleaned_range(scan[beam], limit, max_range)
            smallest = value if value < smallest else smallest
        write_bin(
            scan, directions, is_per_beam, max_range, index, smallest,
            nearest[n], points[n], returns[n],
        )  # fmt: skip
