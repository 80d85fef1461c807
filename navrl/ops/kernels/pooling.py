"""Min-pooling: :func:`navrl.ops.pooling.min_pool` in one pass over the beams."""

import functools

import numpy as np
import torch
from numba import prange
from torch import Tensor

from navrl.ops.kernels.compiler import kernel
from navrl.ops.pooling import RETURN_MARGIN_M, Bearing, beam_offsets, bin_centres


@kernel
def min_pool_kernel(ranges, directions, bearing_rows, limit, max_range, nearest, points, returns):
    """Pool the beams of each scan [S, beams] into bins, in the dtype of ``ranges``.

    A bin's point is drawn along row ``bearing_rows[winning beam]`` of ``directions``, or along its
    own row if it has no return.
    """
    num_bins, size = nearest.shape[1], ranges.shape[1] // nearest.shape[1]
    for n in prange(ranges.shape[0]):
        for index in range(num_bins):
            smallest, row = max_range, index
            for beam in range(index * size, (index + 1) * size):
                reach = ranges[n, beam]
                if reach < smallest and reach < limit and reach > 0.0:
                    smallest, row = reach, bearing_rows[beam]
            nearest[n, index] = smallest
            returns[n, index] = smallest < max_range
            points[n, index, 0] = smallest * directions[row, 0]
            points[n, index, 1] = smallest * directions[row, 1]


@functools.lru_cache(maxsize=16)
def _directions(
    num_beams: int, group_size: int, bearing: Bearing, dtype: torch.dtype
) -> tuple[np.ndarray, np.ndarray]:
    """Return directions [bins (+ beams), 2] and the row that each beam is drawn along [beams]."""
    beam = torch.arange(num_beams)
    angle = bin_centres(num_beams, group_size, dtype)
    rows = beam // group_size
    if bearing == "beam":
        offset = beam_offsets(beam % group_size, num_beams, group_size, dtype)
        angle = torch.cat((angle, angle[rows] + offset))
        rows = beam + num_beams // group_size
    return torch.stack((angle.cos(), angle.sin()), dim=-1).numpy(), rows.numpy()


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
        *_directions(num_beams, group_size, bearing, ranges.dtype),
        real(max_range - RETURN_MARGIN_M),
        real(max_range),
        nearest.numpy(),
        points.numpy(),
        returns.numpy(),
    )
    return nearest, points, returns
