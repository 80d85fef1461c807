"""Scan alignment: :func:`navrl.ops.icp.align` for one pair of scans at a time.

The same algorithm as the torch form, stage by stage; geometry in float64, candidates for nearest
neighbours in float32 (:mod:`navrl.ops.kernels.nearest`).
"""

import math

import numpy as np
import torch
from numba import prange

from navrl.ops.icp import DAMPING, SLIDE_WEIGHT
from navrl.ops.kernels.compiler import kernel, reordering_scalar, scalar
from navrl.ops.kernels.nearest import FAR, find_nearest, is_ordered, unroll
from navrl.ops.lines import HALF_WINDOW, MAX_THICKNESS, MIN_POINTS, REACH_M
from navrl.ops.rotation_search import PROFILE_CAP_M

_CAP = np.float32(PROFILE_CAP_M)
_TURN = 2.0 * math.pi


@reordering_scalar
def profile_cost(source, target, first):
    """Return the mean capped difference of two range profiles, the target's from ``first`` on."""
    total, seen = np.float32(0.0), np.float32(0.0)
    for index in range(source.shape[0]):
        a, b = source[index], target[first + index]
        total += min(abs(a - b), _CAP)
        seen += np.float32(1.0) if min(a, b) < FAR else np.float32(0.0)
    return total / max(seen, np.float32(1.0))


@scalar
def write_profile(points, returns, profile):
    """Write ranges to ``profile``, in as many rounds as it holds; FAR where nothing was seen."""
    count = returns.shape[0]
    for index in range(count):
        x, y = points[index, 0], points[index, 1]
        profile[index] = math.sqrt(x * x + y * y) if returns[index] else FAR
    for column in range(count, profile.shape[0]):
        profile[column] = profile[column - count]


@scalar
def search_rotation(source, source_returns, target, target_returns, search_range):
    """Return the yaw at which the two range profiles agree best."""
    count = source_returns.shape[0]
    source_profile = np.empty(count, dtype=np.float32)
    target_profile = np.empty(3 * count, dtype=np.float32)
    write_profile(source, source_returns, source_profile)
    write_profile(target, target_returns, target_profile)
    max_shift = min(int(search_range / _TURN * count), count // 2)
    best, best_shift = profile_cost(source_profile, target_profile, count), 0
    for size in range(1, max_shift + 1):  # the smaller turn wins a tie, then the negative one
        for shift in (-size, size):
            cost = profile_cost(source_profile, target_profile, count + shift)
            if cost < best:
                best, best_shift = cost, shift
    return best_shift * (_TURN / count)


@scalar
def fit_lines(points, returns, lines):
    """Write the normal's x and y, and whether a line fits, to ``lines`` [3, M]."""
    count = returns.shape[0]
    for index in range(count):
        px, py = points[index, 0], points[index, 1]
        number, mean_x, mean_y, s_xx, s_yy, s_xy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for offset in range(-HALF_WINDOW, HALF_WINDOW + 1):
            other = (index + offset) % count
            dx, dy = points[other, 0] - px, points[other, 1] - py
            if returns[other] and dx * dx + dy * dy < REACH_M * REACH_M:
                number += 1.0
                mean_x += dx
                mean_y += dy
                s_xx += dx * dx
                s_yy += dy * dy
                s_xy += dx * dy
        share = 1.0 / max(number, 1.0)
        s_xx -= share * mean_x * mean_x
        s_yy -= share * mean_y * mean_y
        s_xy -= share * mean_x * mean_y
        half_sum, half_difference = 0.5 * (s_xx + s_yy), 0.5 * (s_xx - s_yy)
        spread = math.sqrt(half_difference * half_difference + s_xy * s_xy)
        is_line = number >= MIN_POINTS and half_sum - spread < MAX_THICKNESS * (half_sum + spread)
        lines[0, index], lines[1, index], lines[2, index] = 0.0, 1.0, 1.0 if is_line else 0.0
        if is_line:  # half of the angle with half_difference and s_xy over spread as cos and sin
            larger = math.sqrt(0.5 * (1.0 + abs(half_difference) / spread))
            smaller = 0.5 * abs(s_xy) / (spread * larger)
            is_along_x = half_difference > 0.0
            lines[0, index] = -math.copysign(smaller if is_along_x else larger, s_xy)
            lines[1, index] = larger if is_along_x else smaller


@scalar
def rigid_step(points, target, match, matched, number):
    """Return the motion that lays matched points over their partners with least squared error."""
    ax, ay, bx, by, cross, dot = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for index in range(match.shape[0]):
        if matched[index]:
            x, y = points[0, index], points[1, index]
            u, v = target[match[index], 0], target[match[index], 1]
            ax, ay, bx, by = ax + x, ay + y, bx + u, by + v
            cross += x * v - y * u
            dot += x * u + y * v
    share = 1.0 / number
    ax, ay, bx, by = ax * share, ay * share, bx * share, by * share
    yaw = math.atan2(cross * share - (ax * by - ay * bx), dot * share - (ax * bx + ay * by))
    cos, sin = math.cos(yaw), math.sin(yaw)
    return bx - (cos * ax - sin * ay), by - (sin * ax + cos * ay), yaw


@scalar
def line_step(points, target, lines, match, matched, robust_scale):
    """Return the Gauss-Newton step for the distances from matched points to their lines."""
    a_xx, a_xy, a_yy, a_xt, a_yt, a_tt = DAMPING, 0.0, DAMPING, 0.0, 0.0, DAMPING
    b_x, b_y, b_t = 0.0, 0.0, 0.0
    for index in range(match.shape[0]):
        if not matched[index]:
            continue
        x, y, column = points[0, index], points[1, index], match[index]
        dx, dy = x - target[column, 0], y - target[column, 1]
        nx, ny = lines[0, column], lines[1, column]
        across, along = dx * nx + dy * ny, dx * ny - dy * nx
        is_line = lines[2, column] > 0.0
        squared = across * across if is_line else dx * dx + dy * dy
        ratio = 1.0 + squared / (robust_scale * robust_scale)
        weight = 1.0 / (ratio * ratio)
        slide = weight * SLIDE_WEIGHT if is_line else weight
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
    # Cholesky-like elimination of a symmetric, positive definite matrix
    f_y, f_t = a_xy / a_xx, a_xt / a_xx
    a_yy, a_yt, a_tt = a_yy - f_y * a_xy, a_yt - f_y * a_xt, a_tt - f_t * a_xt
    b_y, b_t = b_y - f_y * b_x, b_t - f_t * b_x
    g_t = a_yt / a_yy
    yaw = (b_t - g_t * b_y) / (a_tt - g_t * a_yt)
    y = (b_y - a_yt * yaw) / a_yy
    return -(b_x - a_xy * y - a_xt * yaw) / a_xx, -y, -yaw


@scalar
def move_points(points, x, y, yaw, moved, moved_single):
    """Write the moved points [2, N] in both precisions."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    for index in range(points.shape[0]):
        px, py = points[index, 0], points[index, 1]
        moved[0, index] = cos * px - sin * py + x
        moved[1, index] = sin * px + cos * py + y
        moved_single[0, index] = moved[0, index]
        moved_single[1, index] = moved[1, index]


@scalar
def keep_matches(source_returns, squared, match, matched, num_target, gate):
    """Flag the partners within the gate; return how many and their squared distances' sum."""
    number, total = 0, 0.0
    for index in range(match.shape[0]):
        is_match = source_returns[index] and squared[index] <= gate * gate
        matched[index] = is_match
        if match[index] >= num_target:  # a column of the unrolled target
            match[index] %= num_target
        if is_match:
            number += 1
            total += squared[index]
    return number, total


@scalar
def iterate(
    motion, source, source_returns, target, unrolled, lines, is_windowed, use_lines, limits,
    max_iterations, min_pairs,
):  # fmt: skip
    """Step ``motion`` [3] until it converges, fails or runs out of steps.

    Returns:
        (converged, inliers, rmse, iterations) of this stage.
    """
    gate, robust_scale, rotation_tolerance, translation_tolerance, _ = limits
    num_source, num_target = source.shape[0], target.shape[0]
    moved = np.empty((2, num_source), dtype=np.float64)
    moved_single = np.empty((2, num_source), dtype=np.float32)
    squared = np.empty(num_source, dtype=np.float32)
    match = np.empty(num_source, dtype=np.int32)
    matched = np.empty(num_source, dtype=np.int32)
    number, rmse = 0, 0.0
    for iteration in range(max_iterations):
        move_points(source, motion[0], motion[1], motion[2], moved, moved_single)
        shift = round(motion[2] * num_source / _TURN)
        find_nearest(
            moved_single, source_returns, shift, unrolled, is_windowed, gate, squared, match,
            matched,
        )  # fmt: skip
        number, total = keep_matches(source_returns, squared, match, matched, num_target, gate)
        rmse = math.sqrt(total / max(number, 1))
        if number < min_pairs:
            return False, number, rmse, iteration + 1
        if use_lines:
            x, y, yaw = line_step(moved, target, lines, match, matched, robust_scale)
        else:
            x, y, yaw = rigid_step(moved, target, match, matched, number)
        compose_step(motion, x, y, yaw)
        if abs(yaw) < rotation_tolerance and x * x + y * y < translation_tolerance**2:
            return True, number, rmse, iteration + 1
    return False, number, rmse, max_iterations


@scalar
def compose_step(motion, x, y, yaw):
    """Let ``motion`` be followed by a step."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    old_x, old_y = motion[0], motion[1]
    motion[0] = cos * old_x - sin * old_y + x
    motion[1] = sin * old_x + cos * old_y + y
    turned = motion[2] + yaw
    motion[2] = turned - _TURN * math.ceil((turned - math.pi) / _TURN)


@kernel
def align_kernel(
    source, source_returns, target, target_returns, use_search, use_lines, limits,
    max_iterations, min_pairs, motion, converged, inliers, rmse, iterations,
):  # fmt: skip
    """Align scan n of ``source`` [S, N, 2] with scan n of ``target`` [S, M, 2].

    ``limits`` is (gate, robust scale, rotation tolerance, translation tolerance, search range).
    """
    num_source, num_target = source.shape[1], target.shape[1]
    for n in prange(source.shape[0]):
        unrolled = np.empty((4, 3 * num_target), dtype=np.float32)
        unroll(target[n], target_returns[n], unrolled)
        is_windowed = num_source == num_target and is_ordered(target[n])
        lines = np.empty((3, num_target), dtype=np.float64)
        motion[n] = 0.0
        if use_search:
            motion[n, 2] = search_rotation(
                source[n], source_returns[n], target[n], target_returns[n], limits[4]
            )
        converged[n], inliers[n], rmse[n], iterations[n] = iterate(
            motion[n], source[n], source_returns[n], target[n], unrolled, lines, is_windowed,
            False, limits, max_iterations, min_pairs,
        )  # fmt: skip
        if use_lines:
            fit_lines(target[n], target_returns[n], lines)
            spent = iterations[n]
            converged[n], inliers[n], rmse[n], iterations[n] = iterate(
                motion[n], source[n], source_returns[n], target[n], unrolled, lines, is_windowed,
                True, limits, max_iterations, min_pairs,
            )  # fmt: skip
            iterations[n] += spent
        if inliers[n] < min_pairs:
            motion[n] = 0.0


def align_cpu(source, source_returns, target, target_returns, options):
    """Kernel behind :func:`navrl.ops.icp.align`: scans [S, N, 2] in, tensors of [S] out."""
    count = source.shape[0]
    motion = torch.empty(count, 3, dtype=torch.float64)
    rmse = torch.empty(count, dtype=torch.float64)
    converged = torch.empty(count, dtype=torch.bool)
    inliers, iterations = torch.empty(2, count, dtype=torch.int64)
    limits = (
        float(options.gate),
        math.inf if options.robust_scale is None else float(options.robust_scale),
        float(options.rotation_tolerance),
        float(options.translation_tolerance),
        float(options.search_range),
    )
    align_kernel(
        *(scan.detach().contiguous().numpy() for scan in (source, source_returns)),
        *(scan.detach().contiguous().numpy() for scan in (target, target_returns)),
        options.initialization == "rotation_search",
        options.metric == "point_to_line",
        limits,
        options.max_iterations,
        options.min_pairs,
        *(result.numpy() for result in (motion, converged, inliers, rmse, iterations)),
    )
    return motion.to(source.dtype), converged, inliers, rmse.to(source.dtype), iterations
