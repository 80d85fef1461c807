"""Group descriptors in float64: one block per pair of scans, several groups per thread."""

from numba import cuda, int32
from torch import Tensor

from navrl.ops.kernels.cuda.block import num_blocks, own_columns
from navrl.ops.kernels.cuda.launch import block_per_row
from navrl.ops.kernels.grouping import clipped, cos_half_sector, describe, has_return, write_rows

THREADS = 32


def tagd_kernel(
    points: Tensor,
    returns: Tensor,
    previous_points: Tensor,
    previous_returns: Tensor,
    rays: Tensor,
    *others: object,
) -> None:
    """Write descriptors [S, N_c, 4] and their validity [S, N_c, 2]; see the CPU kernel."""
    blocks, width = num_blocks(points), max(points.shape[1], previous_points.shape[1])
    scratch = points.new_empty(blocks, 2, 3, width, dtype=rays.dtype)
    describe_kernel(scratch, points, returns, previous_points, previous_returns, rays, *others)


@block_per_row(THREADS)
def describe_kernel(
    scratch, points, returns, previous_points, previous_returns, rays, radius, max_range,
    now_is_center, previous_fill, zero_without_returns, descriptors, valid,
):  # fmt: skip
    """Iterate over pairs of scans with a grid stride; ``scratch`` is [blocks, 2, 3, N or M]."""
    block, num_groups, cosine = cuda.blockIdx.x, rays.shape[0], cos_half_sector(rays.shape[0])
    num_now, num_before = points.shape[1], previous_points.shape[1]
    now, before = scratch[block, 0, :, :num_now], scratch[block, 1, :, :num_before]
    first, stop = own_columns(num_now)
    first_before, stop_before = own_columns(num_before)
    for n in range(block, points.shape[0], cuda.gridDim.x):
        write_rows(points[n, first:stop], returns[n, first:stop], now[:, first:stop])
        write_rows(
            previous_points[n, first_before:stop_before],
            previous_returns[n, first_before:stop_before],
            before[:, first_before:stop_before],
        )
        has_any = has_return(now[:, first:stop]) or has_return(before[:, first_before:stop_before])
        is_empty = not cuda.syncthreads_or(int32(has_any))
        for group in range(cuda.threadIdx.x, num_groups, cuda.blockDim.x):
            ray_x, ray_y = rays[group, 0], rays[group, 1]
            reach = max_range
            for index in range(num_now):
                x, y, distance = now[0, index], now[1, index], now[2, index]
                reach = min(reach, clipped(x, y, distance, ray_x, ray_y, cosine, max_range))
            describe(
                now, before, ray_x, ray_y, reach, radius, now_is_center, previous_fill,
                descriptors[n, group], valid[n, group],
            )  # fmt: skip
            if zero_without_returns and is_empty:
                for part in range(4):
                    descriptors[n, group, part] = 0.0
        cuda.syncthreads()
