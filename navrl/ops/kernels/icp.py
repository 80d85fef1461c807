"""Scan alignment: kernel of :func:`navrl.ops.icp.align` for one pair of scans at a time.

The algorithm is that of the torch implementation, stage by stage, with geometry in float64 and
nearest-neighbor candidates in float32 (:mod:`navrl.ops.kernels.nearest`). Loops over points have no
branches and contiguous reads, so that the compiler vectorizes them: conditions are weights of 0 or
1, and the values of matched points are gathered beforehand.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from navrl.ops.icp_options import DAMPING, SLIDE_WEIGHT
from navrl.ops.kernels.compiler import kernel, reordering_scalar, scalar
from navrl.ops.kernels.lines import fit_lines
from navrl.ops.kernels.nearest import find_nearest, is_ordered, repeat, unroll
from navrl.ops.kernels.operators import operator
from navrl.ops.kernels.rotation_search import search_rotation

_TWO_PI = 2.0 * math.pi


@scalar
def write_rows(points, returns, rows):
    """Write x, y and the weight (1 for a finite return, else 0) to ``rows`` [3, N].

    Two loops without a branch, so that the compiler vectorizes both.
    """
    xs, ys, weights = rows[0], rows[1], rows[2]
    for index in range(returns.shape[0]):
        xs[index], ys[index] = points[index, 0], points[index, 1]
    for index in range(returns.shape[0]):
        x, y = xs[index], ys[index]
        is_return = abs(x) + abs(y) < (math.inf if returns[index] else 0.0)
        xs[index] = x if is_return else 0.0
        ys[index] = y if is_return else 0.0
        weights[index] = 1.0 if is_return else 0.0


@scalar
def move_points(source, motion, moved, moved_single):
    """Write the transformed points [2, N] in float64 and float32."""
    cos, sin = math.cos(motion[2]), math.sin(motion[2])
    from_x, from_y = source[0], source[1]
    to_x, to_y, single_x, single_y = moved[0], moved[1], moved_single[0], moved_single[1]
    for index in range(source.shape[1]):
        x = cos * from_x[index] - sin * from_y[index] + motion[0]
        y = sin * from_x[index] + cos * from_y[index] + motion[1]
        to_x[index], to_y[index] = x, y
        single_x[index], single_y[index] = x, y


@scalar
def gather(rows, columns, gathered):
    """Copy the listed columns of ``rows`` [R, 3 M] to ``gathered`` [R, N]."""
    for row in range(rows.shape[0]):
        values, copies = rows[row], gathered[row]
        for index in range(columns.shape[0]):
            copies[index] = values[np.uint32(columns[index])]  # unsigned: no negative-index check


@reordering_scalar
def weigh_pairs(returns, squared, gate_squared, weights):
    """Write 1 for each pair within the gate, else 0; return their number and squared sum.

    Points without a return were not searched, so their ``squared`` is undefined and may be NaN.
    """
    number, total = 0.0, 0.0
    for index in range(squared.shape[0]):
        weight = returns[index] if squared[index] <= gate_squared else 0.0
        weights[index] = weight
        number += weight
        total += squared[index] if weight > 0.0 else 0.0
    return number, total


@reordering_scalar
def rigid_sums(points, partners, weights):
    """Return the sums over pairs that :func:`rigid_step` needs."""
    xs, ys, us, vs = points[0], points[1], partners[0], partners[1]
    ax, ay, bx, by, cross, dot = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for index in range(xs.shape[0]):
        x, y, u, v, weight = xs[index], ys[index], us[index], vs[index], weights[index]
        ax += weight * x
        ay += weight * y
        bx += weight * u
        by += weight * v
        cross += weight * (x * v - y * u)
        dot += weight * (x * u + y * v)
    return ax, ay, bx, by, cross, dot


@reordering_scalar
def rigid_step(sums, number):
    """Return the motion that maps points onto their matches with least squared error."""
    ax, ay, bx, by, cross, dot = sums
    share = 1.0 / number
    ax, ay, bx, by = ax * share, ay * share, bx * share, by * share
    yaw = math.atan2(cross * share - (ax * by - ay * bx), dot * share - (ax * bx + ay * by))
    cos, sin = math.cos(yaw), math.sin(yaw)
    return bx - (cos * ax - sin * ay), by - (sin * ax + cos * ay), yaw


@reordering_scalar
def line_sums(points, partners, lines, weights, robust_scale):
    """Return the sums over pairs that :func:`line_step` needs: matrix, then vector."""
    xs, ys, us, vs = points[0], points[1], partners[0], partners[1]
    normal_x, normal_y, line_shares = lines[0], lines[1], lines[2]
    sharpness = 1.0 / (robust_scale * robust_scale)
    a_xx, a_xy, a_yy, a_xt, a_yt, a_tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    b_x, b_y, b_t = 0.0, 0.0, 0.0
    for index in range(xs.shape[0]):
        x, y, nx, ny = xs[index], ys[index], normal_x[index], normal_y[index]
        dx, dy, is_line = x - us[index], y - vs[index], line_shares[index]
        across, along = dx * nx + dy * ny, dx * ny - dy * nx
        # without a line the residual is the point-to-point distance, isotropically weighted
        ratio = 1.0 + (across * across + (1.0 - is_line) * along * along) * sharpness
        weight = weights[index] / (ratio * ratio)
        slide = weight * (1.0 - is_line * (1.0 - SLIDE_WEIGHT))
        lever, slide_lever = x * ny - y * nx, -x * nx - y * ny
        a_xx += weight * nx * nx + slide * ny * ny
        a_xy += (weight - slide) * nx * ny
        a_yy += weight * ny * ny + slide * nx * nx
        a_xt += weight * nx * lever + slide * ny * slide_lever
        a_yt += weight * ny * lever - slide * nx * slide_lever
        a_tt += weight * lever * lever + slide * slide_lever * slide_lever
        b_x += weight * nx * across + slide * ny * along
        b_y += weight * ny * across - slide * nx * along
        b_t += weight * lever * across + slide * slide_lever * along
    return a_xx, a_xy, a_yy, a_xt, a_yt, a_tt, b_x, b_y, b_t


@reordering_scalar
def line_step(sums):
    """Return the Gauss-Newton step for the distances from points to the lines of their matches."""
    a_xx, a_xy, a_yy, a_xt, a_yt, a_tt, b_x, b_y, b_t = sums
    a_xx, a_yy, a_tt = a_xx + DAMPING, a_yy + DAMPING, a_tt + DAMPING
    # Gaussian elimination without pivoting: the matrix is symmetric and positive definite
    f_y, f_t = a_xy / a_xx, a_xt / a_xx
    a_yy, a_yt, a_tt = a_yy - f_y * a_xy, a_yt - f_y * a_xt, a_tt - f_t * a_xt
    b_y, b_t = b_y - f_y * b_x, b_t - f_t * b_x
    g_t = a_yt / a_yy
    yaw = (b_t - g_t * b_y) / (a_tt - g_t * a_yt)
    y = (b_y - a_yt * yaw) / a_yy
    return -(b_x - a_xy * y - a_xt * yaw) / a_xx, -y, -yaw


@scalar
def compose_step(motion, x, y, yaw):
    """Compose ``motion`` with a step, in place."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    old_x, old_y = motion[0], motion[1]
    motion[0] = cos * old_x - sin * old_y + x
    motion[1] = sin * old_x + cos * old_y + y
    turned = motion[2] + yaw
    motion[2] = turned - _TWO_PI * math.ceil((turned - math.pi) / _TWO_PI)


@scalar
def is_small(x, y, yaw, limits):
    """Return whether a step is below the tolerances."""
    return abs(yaw) < limits[2] and x * x + y * y < limits[3] ** 2


@scalar
def iterate(
    motion, source, target, unrolled, lines, is_windowed, use_lines, limits, max_iterations,
    min_pairs,
):  # fmt: skip
    """Iterate ``motion`` [3] until it converges, fails or reaches ``max_iterations``.

    Returns:
        (converged, inliers, rmse, iterations) of this stage.
    """
    gate, robust_scale = limits[0], limits[1]
    count = source.shape[1]
    moved = np.empty((2, count))
    moved_single = np.empty((2, count), dtype=np.float32)
    squared = np.empty(count, dtype=np.float32)
    match, flags = np.zeros(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    partners, partner_lines = np.empty((2, count)), np.empty((3, count))
    weights = np.empty(count)
    number, rmse = 0.0, 0.0
    for iteration in range(max_iterations):
        move_points(source, motion, moved, moved_single)
        shift = round(motion[2] * count / _TWO_PI)
        find_nearest(
            moved_single, source[2], shift, unrolled, is_windowed, gate, squared, match, flags
        )
        number, total = weigh_pairs(source[2], squared, gate * gate, weights)
        rmse = math.sqrt(total / max(number, 1.0))
        if number < min_pairs:
            return False, number, rmse, iteration + 1
        gather(target, match, partners)
        if use_lines:
            gather(lines, match, partner_lines)
            x, y, yaw = line_step(line_sums(moved, partners, partner_lines, weights, robust_scale))
        else:
            x, y, yaw = rigid_step(rigid_sums(moved, partners, weights), number)
        compose_step(motion, x, y, yaw)
        if is_small(x, y, yaw, limits):
            return True, number, rmse, iteration + 1
    return False, number, rmse, max_iterations


@kernel
def align_kernel(
    rows, source, source_returns, target, target_returns, seen, is_partial, use_search, use_lines,
    limits, max_iterations, min_pairs, motion, converged, inliers, rmse, iterations,
):  # fmt: skip
    """Align scan n of ``source`` [S, N, 2] with scan n of ``target`` [S, M, 2].

    ``seen`` [S, N] is only read if ``is_partial``; ``limits`` is (gate, robust scale, rotation
    tolerance, translation tolerance, search range).
    """
    num_source, num_target = source.shape[1], target.shape[1]
    for n in range(rows[0], rows[1]):
        source_rows = np.empty((3, num_source))
        target_rows = np.empty((3, 3 * num_target))
        unrolled = np.empty((4, 3 * num_target), dtype=np.float32)
        lines = np.empty((3, 3 * num_target))
        write_rows(source[n], source_returns[n], source_rows)
        write_rows(target[n], target_returns[n], target_rows)
        repeat(target_rows)
        unroll(target[n], target_rows[2], unrolled)
        is_windowed = num_source == num_target and is_ordered(target[n])
        motion[n] = 0.0
        if use_search:
            once = target_rows[:, :num_target]
            motion[n, 2] = search_rotation(source_rows, once, seen[n], is_partial, limits[4])
        spent = 0
        for stage in range(2 if use_lines else 1):
            if stage == 1:
                fit_lines(target_rows[:, :num_target], lines)
                repeat(lines)
            converged[n], inliers[n], rmse[n], steps = iterate(
                motion[n], source_rows, target_rows[:2], unrolled, lines, is_windowed,
                stage == 1, limits, max_iterations, min_pairs,
            )  # fmt: skip
            spent += steps
        iterations[n] = spent
        if inliers[n] < min_pairs:
            motion[n] = 0.0


Aligned = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


def _aligned(source: Tensor, *_: object, dtype: torch.dtype | None = None) -> Aligned:
    """Return empty motion, convergence, inliers, residual and iterations."""
    count = source.shape[0]
    return (
        source.new_empty(count, 3, dtype=dtype),
        source.new_empty(count, dtype=torch.bool),
        source.new_empty(count, dtype=torch.int64),
        source.new_empty(count, dtype=dtype),
        source.new_empty(count, dtype=torch.int64),
    )


@operator(_aligned)
def align_scans(
    source: Tensor,
    source_returns: Tensor,
    target: Tensor,
    target_returns: Tensor,
    seen: Tensor | None,
    initialization: str,
    metric: str,
    limits: Sequence[float],
    max_iterations: int,
    min_pairs: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Align scans [S, N, 2] for :func:`navrl.ops.icp.align`; return fields of its result.

    ``limits`` is (gate, robust scale or infinity, rotation tolerance, translation tolerance, search
    range).
    """
    results = _aligned(source, dtype=torch.float64)
    motion, converged, inliers, rmse, iterations = results
    align_kernel(
        *(scan.contiguous() for scan in (source, source_returns, target, target_returns)),
        (source_returns if seen is None else seen).contiguous(),
        seen is not None,
        initialization == "rotation_search",
        metric == "point_to_line",
        tuple(limits),
        max_iterations,
        min_pairs,
        *(motion, converged, inliers, rmse, iterations),
    )
    return motion.to(source.dtype), converged, inliers, rmse.to(source.dtype), iterations
