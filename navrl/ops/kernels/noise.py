"""Range noise: the hash and the table lookup of :mod:`navrl.ops.noise` in one pass."""

import numpy as np
import torch
from numba import prange
from torch import Tensor

from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.noise import HIT_MARGIN

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_1, _SHIFT_2, _SHIFT_3 = np.uint64(30), np.uint64(27), np.uint64(31)
_ROW = np.uint64(4095)  # twelve bits of a word pick a row of the table
_ROW_1, _ROW_2, _ROW_3 = np.uint64(12), np.uint64(24), np.uint64(36)


@scalar
def mix(word):
    """splitmix64's finaliser, uint64."""
    word = (word ^ (word >> _SHIFT_1)) * _MIX_1
    word = (word ^ (word >> _SHIFT_2)) * _MIX_2
    return word ^ (word >> _SHIFT_3)


@scalar
def add_noise(ranges, out, seed, step, table, max_range, max_hit):
    """Write the noisy scan of one world into ``out``; int64 seed and step, float32 else.

    Two passes over a row that stays in cache: the second one, without look-ups, is vectorised.
    """
    num_beams = ranges.shape[0]
    key = mix(mix(np.uint64(seed) + _GOLDEN) + np.uint64(step))
    num_words = num_beams // 4
    for group in range(num_words):
        word = mix(key + _GOLDEN * np.uint64(group + 1))
        beam = 4 * group
        out[beam] = table[word & _ROW]
        out[beam + 1] = table[(word >> _ROW_1) & _ROW]
        out[beam + 2] = table[(word >> _ROW_2) & _ROW]
        out[beam + 3] = table[(word >> _ROW_3) & _ROW]
    word = mix(key + _GOLDEN * np.uint64(num_words + 1))
    for beam in range(4 * num_words, num_beams):
        out[beam] = table[word & _ROW]
        word >>= _ROW_1
    for beam in range(num_beams):
        noisy = ranges[beam] + out[beam]
        if noisy < 0.0:  # min() and max() would keep this loop from being vectorised
            noisy = np.float32(0.0)
        if noisy > max_hit:
            noisy = max_hit
        out[beam] = noisy if ranges[beam] < max_range else ranges[beam]


@kernel
def add_range_noise_kernel(ranges, out, seed, step, table, max_range, max_hit):
    """Noisy scans of all worlds."""
    for world in prange(ranges.shape[0]):
        add_noise(ranges[world], out[world], seed[world], step[world], table, max_range, max_hit)


def add_range_noise_cpu(
    ranges: Tensor, seed: Tensor, step: Tensor, table: Tensor, max_range: float
) -> Tensor:
    """Kernel behind :func:`navrl.ops.noise.add_range_noise`, whose checks its arguments passed."""
    out = torch.empty_like(ranges, memory_format=torch.contiguous_format)
    add_range_noise_kernel(
        ranges.detach().contiguous().numpy(),
        out.numpy(),
        seed.contiguous().numpy(),
        step.contiguous().numpy(),
        table.numpy(),
        np.float32(max_range),
        np.float32(max_range - HIT_MARGIN),
    )
    return out
