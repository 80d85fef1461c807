"""Range noise: one block per scan, four beams per thread and iteration."""

from numba import cuda

from navrl.ops.kernels.cuda.launch import block_per_row
from navrl.ops.kernels.noise import add_to_ranges, draw_noise, scan_key

THREADS = 128


@block_per_row(THREADS)
def add_range_noise_kernel(ranges, out, seed, step, table, max_range, max_hit):
    """Write the noisy scans of all worlds to ``out``."""
    n = cuda.blockIdx.x
    key = scan_key(seed[n], step[n])
    clean, noisy = ranges[n], out[n]
    for group in range(cuda.threadIdx.x, (clean.shape[0] + 3) // 4, cuda.blockDim.x):
        draw_noise(noisy, key, table, group, group + 1)
        own = slice(4 * group, 4 * group + 4)
        add_to_ranges(clean[own], noisy[own], max_range, max_hit)
