"""Scan alignment: one block per pair of scans, a contiguous range of points per thread.

Every thread applies the scalar functions of the CPU kernel to its own columns, the sums of all
threads are reduced in a fixed order, and each thread computes the same step from the result.
"""

import math

import torch
from numba import cuda, float64
from torch import Tensor

from navrl.ops.kernels.cuda.block import add_up, num_blocks, own_columns, repeat_columns
from navrl.ops.kernels.cuda.launch import block_per_row
from navrl.ops.kernels.icp import (
    compose_step,
    gather,
    is_small,
    line_step,
    line_sums,
    move_points,
    rigid_step,
    rigid_sums,
    weigh_pairs,
    write_rows,
)
from navrl.ops.kernels.lines import continue_rows, sum_neighbors, write_lines
from navrl.ops.kernels.nearest import (
    SMALLEST,
    WINDOW,
    find_unverified,
    first_column,
    is_ordered,
    search_window,
    write_directed,
)
from navrl.ops.kernels.rotation_search import (
    best_shift,
    hide_unseen,
    largest_shift,
    profile_cost,
    profile_cost_covered,
    write_profile,
)
from navrl.ops.lines import HALF_WINDOW

THREADS = 128
NUM_SUMS = 11  # number of pairs, sum of squared distances, and nine sums of a step

_TWO_PI = 2.0 * math.pi
_REAL_ROWS, _SINGLE_ROWS, _WHOLE_ROWS = 23, 10, 2


def align_kernel(source: Tensor, source_returns: Tensor, target: Tensor, *others: object) -> None:
    """Align scan n of ``source`` [S, N, 2] with scan n of ``target``; see the CPU kernel."""
    num_source, num_target = source.shape[1], target.shape[1]
    width = max(num_source, 3 * num_target, num_target + 2 * HALF_WINDOW)
    kinds = ((_REAL_ROWS, torch.float64), (_SINGLE_ROWS, torch.float32), (_WHOLE_ROWS, torch.int32))
    blocks = num_blocks(source)
    scratch = [source.new_empty(blocks, rows, width, dtype=dtype) for rows, dtype in kinds]
    align_scans_kernel(*scratch, source, source_returns, target, *others)


@cuda.jit(device=True)
def search_own_shift(source, target, seen, is_partial, search_range, profiles, own):
    """Run ``search_rotation`` of the CPU kernel in one block; ``profiles`` is scratch [3, 3 M]."""
    count = source.shape[1]
    first, stop = own
    source_profile, profile, costs = profiles[0, :count], profiles[1], profiles[2]
    write_profile(source[:, first:stop], source_profile[first:stop])
    write_profile(target[:, first:stop], profile[first:stop])
    if is_partial and first < stop:
        hide_unseen(seen[first:stop], source_profile[first:stop])
        hide_unseen(seen[first:stop], profile[first:stop])
    repeat_columns(profiles[1:2], count, first, stop)
    cuda.syncthreads()
    max_shift = largest_shift(search_range, count)
    for column in range(cuda.threadIdx.x, 2 * max_shift + 1, cuda.blockDim.x):
        start = count - max_shift + column
        turned = profile[start : start + count]
        if is_partial:
            costs[column] = profile_cost_covered(source_profile, turned)
        else:
            costs[column] = profile_cost(source_profile, turned)
    cuda.syncthreads()
    return best_shift(costs[: 2 * max_shift + 1]) * (_TWO_PI / count)


@cuda.jit(device=True)
def search_all(x, y, target_x, target_y, num_target):
    """Return the smallest squared distance from one point, and its column."""
    best, match = math.inf, 0
    for column in range(num_target):
        dx, dy = x - target_x[column], y - target_y[column]
        squared = dx * dx + dy * dy
        if squared < best:
            best, match = squared, column
    return best, match


@cuda.jit(device=True)
def find_own_nearest(points, weights, first, shift, target, is_windowed, gate, squared, whole):
    """Run ``find_nearest`` of the CPU kernel for the points from column ``first`` on."""
    num_target = target.shape[1] // 3
    x, y, match, flags = points[0], points[1], whole[0], whole[1]
    flags[:] = 1
    if is_windowed and num_target >= SMALLEST:
        start, ahead = first_column(shift, num_target), target[:, first:]
        squared[:] = math.inf
        search_window(x, y, ahead[0], ahead[1], start, squared, match)
        find_unverified(
            x, y, weights, ahead[2], ahead[3], start, WINDOW, gate * gate, squared, flags
        )
    for index in range(x.shape[0]):
        match[index] += first
        if flags[index] != 0:
            match[index] = 0
            if weights[index] > 0.0:
                squared[index], match[index] = search_all(
                    x[index], y[index], target[0], target[1], num_target
                )


@cuda.jit(device=True)
def iterate(
    motion, source, target, unrolled, lines, is_windowed, use_lines, limits, max_iterations,
    min_pairs, reals, singles, whole, partials, own,
):  # fmt: skip
    """Run ``iterate`` of the CPU kernel on arrays that hold only the columns of this thread.

    ``target``, ``unrolled`` and ``lines`` hold all columns; ``own`` is the first column of this
    thread and the number of points of all threads.
    """
    gate, robust_scale = limits[0], limits[1]
    moved, partners, partner_lines, weights = reals[0:2], reals[2:4], reals[4:7], reals[7]
    moved_single, squared = singles[0:2], singles[2]
    sums = partials[cuda.threadIdx.x]
    number, rmse = 0.0, 0.0
    for iteration in range(max_iterations):
        move_points(source, motion, moved, moved_single)
        shift = round(motion[2] * own[1] / _TWO_PI)
        find_own_nearest(
            moved_single, source[2], own[0], shift, unrolled, is_windowed, gate, squared, whole
        )
        cuda.syncthreads()  # all threads must have read the previous totals
        sums[0], sums[1] = weigh_pairs(source[2], squared, gate * gate, weights)
        gather(target, whole[0], partners)
        if use_lines:
            gather(lines, whole[0], partner_lines)
            (
                sums[2], sums[3], sums[4], sums[5], sums[6], sums[7], sums[8], sums[9], sums[10],
            ) = line_sums(moved, partners, partner_lines, weights, robust_scale)  # fmt: skip
        else:
            sums[2], sums[3], sums[4], sums[5], sums[6], sums[7] = rigid_sums(
                moved, partners, weights
            )
        add_up(partials)
        t = partials[0]
        number = t[0]
        rmse = math.sqrt(t[1] / max(number, 1.0))
        if number < min_pairs:
            return False, number, rmse, iteration + 1
        if use_lines:
            x, y, yaw = line_step((t[2], t[3], t[4], t[5], t[6], t[7], t[8], t[9], t[10]))
        else:
            x, y, yaw = rigid_step((t[2], t[3], t[4], t[5], t[6], t[7]), number)
        compose_step(motion, x, y, yaw)
        if is_small(x, y, yaw, limits):
            return True, number, rmse, iteration + 1
    return False, number, rmse, max_iterations


@cuda.jit(device=True)
def prepare(source, source_returns, target, target_returns, source_rows, target_rows, unrolled):
    """Write both scans as rows, with three copies of the target."""
    first, stop = own_columns(source.shape[0])
    write_rows(source[first:stop], source_returns[first:stop], source_rows[:, first:stop])
    count = target.shape[0]
    first, stop = own_columns(count)
    write_rows(target[first:stop], target_returns[first:stop], target_rows[:, first:stop])
    write_directed(target[first:stop], target_rows[2, first:stop], unrolled[:, first:stop])
    repeat_columns(target_rows, count, first, stop)
    repeat_columns(unrolled, count, first, stop)
    cuda.syncthreads()


@cuda.jit(device=True)
def fit_own_lines(rows, padded, sums, lines):
    """Run ``fit_lines`` of the CPU kernel in one block and write three copies of the lines."""
    count = rows.shape[1]
    first, stop = own_columns(count + 2 * HALF_WINDOW)
    continue_rows(rows, padded, first, stop)
    cuda.syncthreads()
    first, stop = own_columns(count)
    end = stop + 2 * HALF_WINDOW
    sum_neighbors(padded[0, first:end], padded[1, first:end], sums[:, first:stop])
    write_lines(sums[:, first:stop], lines[:, first:stop])
    repeat_columns(lines, count, first, stop)
    cuda.syncthreads()


@block_per_row(THREADS)
def align_scans_kernel(
    reals, singles, whole, source, source_returns, target, target_returns, seen, is_partial,
    use_search, use_lines, limits, max_iterations, min_pairs, motion, converged, inliers, rmse,
    iterations,
):  # fmt: skip
    """Iterate over pairs of scans; the first three arrays are scratch [blocks, rows, columns]."""
    block, num_source, num_target = cuda.blockIdx.x, source.shape[1], target.shape[1]
    partials = cuda.shared.array((THREADS, NUM_SUMS), float64)
    guess = cuda.local.array(3, float64)
    first, stop = own_columns(num_source)
    source_rows, target_rows = reals[block, 0:3, :num_source], reals[block, 3:6, : 3 * num_target]
    lines, padded = reals[block, 6:9, : 3 * num_target], reals[block, 9:11]
    sums, own_reals = reals[block, 11:15, :num_target], reals[block, 15:23, first:stop]
    unrolled, profiles = singles[block, 0:4, : 3 * num_target], singles[block, 4:7]
    own_singles, own_whole = singles[block, 7:10, first:stop], whole[block, :, first:stop]
    for n in range(block, source.shape[0], cuda.gridDim.x):
        prepare(
            source[n], source_returns[n], target[n], target_returns[n],
            source_rows, target_rows, unrolled,
        )  # fmt: skip
        is_windowed = num_source == num_target and is_ordered(target[n])
        guess[0], guess[1], guess[2] = 0.0, 0.0, 0.0
        if use_search:
            once = target_rows[:, :num_target]
            guess[2] = search_own_shift(
                source_rows, once, seen[n], is_partial, limits[4], profiles, (first, stop)
            )
        spent, number = 0, 0.0
        for stage in range(2 if use_lines else 1):
            if stage == 1:
                fit_own_lines(target_rows[:, :num_target], padded, sums, lines)
            is_done, number, error, steps = iterate(
                guess, source_rows[:, first:stop], target_rows[:2], unrolled, lines, is_windowed,
                stage == 1, limits, max_iterations, min_pairs, own_reals, own_singles, own_whole,
                partials, (first, num_source),
            )  # fmt: skip
            spent += steps
        if cuda.threadIdx.x == 0:
            converged[n], inliers[n], rmse[n], iterations[n] = is_done, number, error, spent
            for part in range(3):
                motion[n, part] = guess[part] if number >= min_pairs else 0.0
        cuda.syncthreads()
