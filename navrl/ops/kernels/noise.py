"""Range noise: kernel of :mod:`navrl.ops.noise`, hash and table lookup in one pass."""

import numpy as np
import torch
from torch import Tensor

from navrl.ops.beams import HIT_MARGIN
from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.operators import operator

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_SHIFT_1, _SHIFT_2, _SHIFT_3 = np.uint64(30), np.uint64(27), np.uint64(31)
_ROW = np.uint64(4095)  # twelve bits of a word select a row of the table
_ROW_1, _ROW_2, _ROW_3 = np.uint64(12), np.uint64(24), np.uint64(36)


@scalar
def mix(word):
    """Apply the splitmix64 finalizer, uint64."""
    word = (word ^ (word >> _SHIFT_1)) * _MIX_1
    word = (word ^ (word >> _SHIFT_2)) * _MIX_2
    return word ^ (word >> _SHIFT_3)


@scalar
def scan_key(seed, step):
    """Return the uint64 hash key of one scan from its int64 seed and step."""
    return mix(mix(np.uint64(seed) + _GOLDEN) + np.uint64(step))


@scalar
def draw_noise(out, key, table, first, stop):
    """Write the noise of the beam groups ``first .. stop - 1``; a group has four beams or less."""
    num_words = out.shape[0] // 4
    for group in range(first, min(stop, num_words)):
        word = mix(key + _GOLDEN * np.uint64(group + 1))
        beam = 4 * group
        out[beam] = table[word & _ROW]
        out[beam + 1] = table[(word >> _ROW_1) & _ROW]
        out[beam + 2] = table[(word >> _ROW_2) & _ROW]
        out[beam + 3] = table[(word >> _ROW_3) & _ROW]
    if stop > num_words:
        word = mix(key + _GOLDEN * np.uint64(num_words + 1))
        for beam in range(4 * num_words, out.shape[0]):
            out[beam] = table[word & _ROW]
            word >>= _ROW_1


@scalar
def add_to_ranges(ranges, out, max_range, max_hit):
    """Add ``ranges`` to the noise in ``out``, float32; separate from the lookups to vectorize."""
    for beam in range(ranges.shape[0]):
        noisy = ranges[beam] + out[beam]
        if noisy < 0.0:  # min() and max() would prevent vectorization
            noisy = np.float32(0.0)
        if noisy > max_hit:
            noisy = max_hit
        out[beam] = noisy if ranges[beam] < max_range else ranges[beam]


@kernel
def add_range_noise_kernel(rows, ranges, out, seed, step, table, max_range, max_hit):
    """Write the noisy scans of all worlds to ``out``."""
    for world in range(rows[0], rows[1]):
        key = scan_key(seed[world], step[world])
        draw_noise(out[world], key, table, 0, out.shape[1] // 4 + 1)
        add_to_ranges(ranges[world], out[world], max_range, max_hit)  # still in cache


def _noisy(ranges: Tensor, *_: object) -> Tensor:
    return torch.empty_like(ranges, memory_format=torch.contiguous_format)


@operator(_noisy, shared=["table"])
def add_noise(
    ranges: Tensor, seed: Tensor, step: Tensor, table: Tensor, max_range: float
) -> Tensor:
    """Run the kernel of :func:`navrl.ops.noise.add_range_noise` on validated arguments."""
    out = _noisy(ranges)
    add_range_noise_kernel(
        ranges.contiguous(),
        out,
        seed.contiguous(),
        step.contiguous(),
        table.contiguous(),
        np.float32(max_range),
        np.float32(max_range - HIT_MARGIN),
    )
    return out
