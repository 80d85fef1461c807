"""Min-pooling: kernel of :func:`navrl.ops.pooling.min_pool`, one pass over the beams."""

import numpy as np
import torch
from torch import Tensor

from navrl.ops.beams import RETURN_MARGIN_M
from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.operators import operator


@scalar
def cleaned_range(value, limit, max_range):
    """Return a reading, or ``max_range`` if it is not a return (NaN, not positive, or too far)."""
    return value if (value > 0.0) & (value < limit) else max_range


@scalar
def write_bin(scan, directions, is_per_beam, max_range, index, smallest, nearest, points, returns):
    """Write the ``index``-th bin of a scan whose smallest cleaned reading is ``smallest``."""
    num_bins = nearest.shape[0]
    is_return, row = smallest < max_range, index
    if is_per_beam and is_return:
        row = num_bins + index * (scan.shape[0] // num_bins)
        while scan[row - num_bins] != smallest:
            row += 1
    nearest[index], returns[index] = smallest, is_return
    points[index, 0] = smallest * directions[row, 0]
    points[index, 1] = smallest * directions[row, 1]


@kernel
def min_pool_kernel(
    rows, ranges, directions, is_per_beam, limit, max_range, nearest, points, returns
):
    """Pool the beams of each scan [S, beams] into bins, in the dtype of ``ranges``.

    ``directions`` holds the unit vectors of the bins [bins, 2], followed, if ``is_per_beam``, by
    those of the beams [beams, 2].
    """
    num_beams, num_bins = ranges.shape[1], nearest.shape[1]
    size = num_beams // num_bins
    for n in range(rows[0], rows[1]):
        scan = ranges[n]
        cleaned = np.empty_like(scan)
        for beam in range(num_beams):
            cleaned[beam] = cleaned_range(scan[beam], limit, max_range)
        for index in range(num_bins):
            smallest = max_range
            for beam in range(index * size, (index + 1) * size):
                smallest = cleaned[beam] if cleaned[beam] < smallest else smallest
            write_bin(
                scan, directions, is_per_beam, max_range, index, smallest,
                nearest[n], points[n], returns[n],
            )  # fmt: skip


def _pooled(ranges: Tensor, num_bins: int, *_: object) -> tuple[Tensor, Tensor, Tensor]:
    num_scans = ranges.shape[0]
    nearest = ranges.new_empty(num_scans, num_bins)
    points = ranges.new_empty(num_scans, num_bins, 2)
    return nearest, points, ranges.new_empty(num_scans, num_bins, dtype=torch.bool)


@operator(_pooled, shared=["directions"])
def pool(
    ranges: Tensor, num_bins: int, directions: Tensor, max_range: float, bearing: str
) -> tuple[Tensor, Tensor, Tensor]:
    """Run the kernel of :func:`navrl.ops.pooling.min_pool` on scans [S, beams] in bin order."""
    pooled = _pooled(ranges, num_bins)
    real = np.float32 if ranges.dtype == torch.float32 else np.float64
    min_pool_kernel(
        ranges.contiguous(),
        directions,
        bearing == "beam",
        real(max_range - RETURN_MARGIN_M),
        real(max_range),
        *pooled,
    )
    return pooled
