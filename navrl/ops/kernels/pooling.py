"""Min-pooling: :func:`navrl.ops.pooling.min_pool` in one pass over the beams."""

import functools

import numpy as np
import torch
from numba import prange
from torch import Tensor

from navrl.ops.kernels.compiler import kernel
from navrl.ops.pooling import RETURN_MARGIN_M, Bearing, beam_offsets, bin_centres


@kernel
def min_pool_kernel(ranges, directions, is_per_beam, limit, max_range, nearest, points, returns):
    """Pool the beams of each scan [S, beams] into bins, in the dtype of ``ranges``.

    ``directions`` are those of the bins [bins, 2], and after them, if a point is to be drawn along
    the beam that measured it, those of the beams [beams, 2].
    """
    num_beams, num_bins = ranges.shape[1], nearest.shape[1]
    size = num_beams // num_bins
    for n in prange(ranges.shape[0]):
        scan = ranges[n]
        cleaned = np.empty_like(scan)
        for beam in range(num_beams):
            is_return = (scan[beam] > 0.0) & (scan[beam] < limit)
            cleaned[beam] = scan[beam] if is_return else max_range
        for index in range(num_bins):
            smallest, row = max_range, index
            for beam in range(index * size, (index + 1) * size):
                smallest = cleaned[beam] if cleaned[beam] < smallest else smallest
            is_return = smallest < max_range
            if is_per_beam and is_return:
                row = num_bins + index * size
                while scan[row - num_bins] != smallest:
                    row += 1
            nearest[n, index], returns[n, index] = smallest, is_return
            points[n, index, 0] = smallest * directions[row, 0]
            points[n, index, 1] = smallest * directions[row, 1]


@functools.lru_cache(maxsize=16)
def _directions(
    num_beams: int, group_size: int, bearing: Bearing, dtype: torch.dtype
) -> np.ndarray:
    """Return the directions [bins (+ beams), 2] that :func:`min_pool_kernel` reads."""
    angle = bin_centres(num_beams, group_size, dtype)
    if bearing == "beam":
        beam = torch.arange(num_beams)
        offset = beam_offsets(beam % group_size, num_beams, group_size, dtype)
        angle = torch.cat((angle, angle[beam // group_size] + offset))
    return torch.stack((angle.cos(), angle.sin()), dim=-1).numpy()


def min_pool_cpu(
    ranges: Tensor, group_size: int, max_range: float, bearing: Bearing
) -> tuple[Tensor, Tensor, Tensor]:
    """Kernel behind :func:`navrl.ops.pooling.min_pool`: scans [S, beams] in."""
    num_scans, num_beams = ranges.shape
    num_bins = num_beams // group_size
    nearest = ranges.new_empty(num_scans, num_bins)
    points = ranges.new_empty(num_scans, num_bins, 2)
    returns = torch.empty(num_scans, num_bins, dtype=torch.bool)
    beams = ranges.detach().contiguous().numpy()
    real = beams.dtype.type
    min_pool_kernel(
        beams,
        _directions(num_beams, group_size, bearing, ranges.dtype),
        bearing == "beam",
        real(max_range - RETURN_MARGIN_M),
        real(max_range),
        nearest.numpy(),
        points.numpy(),
        returns.numpy(),
    )
    return nearest, points, returns
