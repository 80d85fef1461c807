"""Exact windowed nearest-neighbor search between two scans ordered by bearing.

After the rotation by the estimated yaw, the nearest neighbor of point i of one scan is among a few
points around index i of the other. This window is searched for all points at once in a vectorized
loop. Then each result is verified: target points outside of the window lie beyond the two rays that
bound it, so none of them is nearer than the distance of the point to these rays. If many points
fail this test, the window is widened for all; the remaining points are searched exhaustively.
"""

import math

import numpy as np

from navrl.ops.kernels.compiler import reordering_scalar, scalar

WINDOW = 17  # points; with 2 deg per point this is +-16 deg around the expected bearing
MARGIN = 8  # points by which the window is widened on both sides
MAX_SEARCHES = 6  # points; beyond this, widening the window is faster than exhaustive searches
SMALLEST = 3 * WINDOW  # points; smaller scans are searched exhaustively
FAR = np.float32(1e9)  # m; coordinate of points without a return
SAFETY_FACTOR = np.float32(0.999)  # safety factor for the rounding of the test in single precision


@scalar
def is_ordered(points):
    """Return whether the points [M, 2] wind around the origin counter-clockwise exactly once."""
    count = points.shape[0]
    turns = 0
    for index in range(count):
        x, y = points[index - 1, 0], points[index - 1, 1]
        next_x, next_y = points[index, 0], points[index, 1]
        if not x * next_y - y * next_x > 0.0:
            return False
        if y < 0.0 <= next_y:
            turns += 1
    return turns == 1


@scalar
def repeat(rows):
    """Copy the first third of the columns to the second and the third."""
    count = rows.shape[1] // 3
    for row in range(rows.shape[0]):
        values = rows[row]
        for column in range(count):  # five times faster than slice assignment
            value = values[column]
            values[column + count] = value
            values[column + 2 * count] = value


@scalar
def write_directed(points, weights, rows):
    """Write x, y and unit vector of the target to the first M columns of ``rows`` float32."""
    for index in range(points.shape[0]):
        x, y = np.float32(points[index, 0]), np.float32(points[index, 1])
        scale = np.float32(1.0) / math.sqrt(x * x + y * y)
        rows[0, index] = x if weights[index] > 0.0 else FAR
        rows[1, index] = y if weights[index] > 0.0 else FAR
        rows[2, index] = x * scale
        rows[3, index] = y * scale


@scalar
def unroll(points, weights, rows):
    """Write three copies of the target to ``rows`` [4, 3 M] float32: x, y and unit vector."""
    write_directed(points, weights, rows)
    repeat(rows)


@scalar
def first_column(shift, num_target):
    """Return the start of the first point's window in the unrolled target, minus a margin."""
    room = num_target // 3
    return room + (shift - WINDOW // 2 - room) % num_target


def column_search(width):
    """Return a search over ``width`` columns; the compiler unrolls up to about twenty of them."""

    @reordering_scalar
    def search_columns(x, y, target_x, target_y, first, squared, match):
        """Update the smallest squared distance and its column for points [N] float32.

        Point i is compared with the columns ``first + i .. first + i + width - 1`` of the target.
        """
        near_x, near_y = target_x[first:], target_y[first:]
        for index in range(x.shape[0]):
            own_x, own_y = x[index], y[index]
            smallest, column = squared[index], match[index]
            for offset in range(width):
                dx, dy = own_x - near_x[index + offset], own_y - near_y[index + offset]
                candidate = dx * dx + dy * dy
                is_nearer = candidate < smallest
                smallest = candidate if is_nearer else smallest
                column = np.int32(first + index + offset) if is_nearer else column
            squared[index], match[index] = smallest, column

    return search_columns


search_window, search_margin = column_search(WINDOW), column_search(MARGIN)


@reordering_scalar
def find_unverified(
    x, y, weights, direction_x, direction_y, first, width, gate_squared, squared, unverified
):
    """Flag the points whose nearest neighbor may be outside of the window; return their number.

    Neighbors beyond the gate are rejected later, so the test only covers distances up to the gate;
    points with zero weight are not tested.
    """
    count = x.shape[0]
    low_x, low_y = direction_x[first - 1 :], direction_y[first - 1 :]
    high_x, high_y = direction_x[first + width :], direction_y[first + width :]
    total = 0
    for index in range(count):
        px, py = x[index], y[index]
        reach = px * px + py * py
        above_low = low_x[index] * py - low_y[index] * px  # signed distance from the ray's line
        below_high = px * high_y[index] - py * high_x[index]
        is_inside = above_low > 0.0 and below_high > 0.0
        low = above_low * above_low if low_x[index] * px + low_y[index] * py > 0.0 else reach
        high = below_high * below_high if high_x[index] * px + high_y[index] * py > 0.0 else reach
        bound = SAFETY_FACTOR * min(low, high)
        needed = min(squared[index], gate_squared)
        is_unverified = weights[index] > 0.0 and not (is_inside and needed <= bound)
        unverified[index] = is_unverified
        total += is_unverified
    return total


@scalar
def search_all(x, y, target_x, target_y, distances):
    """Return the smallest squared distance from one point, and its column.

    ``distances`` [M] float32 is scratch. The bits of positive floats, read as integers, have the
    same order, and the compiler vectorizes only the integer minimum.
    """
    for column in range(distances.shape[0]):
        dx, dy = x - target_x[column], y - target_y[column]
        distances[column] = dx * dx + dy * dy
    bits = distances.view(np.int32)
    smallest = bits[0]
    for column in range(1, bits.shape[0]):
        smallest = min(smallest, bits[column])
    match = 0
    while bits[match] != smallest:
        match += 1
    return distances[match], match


@scalar
def search_windows(points, weights, shift, target, gate, squared, match, flags):
    """Search windows of increasing width; flag the unverified points and return their number."""
    x, y, target_x, target_y = points[0], points[1], target[0], target[1]
    num_target = target.shape[1] // 3
    first, width = first_column(shift, num_target), WINDOW
    squared[:] = np.float32(np.inf)
    search_window(x, y, target_x, target_y, first, squared, match)
    while True:
        total = find_unverified(
            x, y, weights, target[2], target[3], first, width, gate * gate, squared, flags
        )
        width += 2 * MARGIN
        if (
            total <= MAX_SEARCHES or width > num_target // 2
        ):  # the test only holds within a half circle
            return total
        search_margin(x, y, target_x, target_y, first - MARGIN, squared, match)
        search_margin(x, y, target_x, target_y, first + width - 2 * MARGIN, squared, match)
        first -= MARGIN


@scalar
def find_nearest(points, weights, shift, target, is_windowed, gate, squared, match, flags):
    """Write squared distance and column of the nearest neighbor of each point within the gate.

    Args:
        points: [2, N] float32, x and y of the transformed source.
        weights: [N], zero for points without a return, which are not searched.
        shift: Index offset from the source to the target.
        target: [4, 3 M] float32, from :func:`unroll`.
        is_windowed: Whether both scans are ordered and of the same length.
        gate: Largest distance of a match, m; results beyond it may be inexact.
        squared, match: [N] float32 and int32, outputs.
        flags: [N] int32, scratch.
    """
    num_target = target.shape[1] // 3
    if is_windowed and num_target >= SMALLEST:
        gate = np.float32(gate)
        if search_windows(points, weights, shift, target, gate, squared, match, flags) == 0:
            return
    else:
        flags[:] = 1
    distances = np.empty(num_target, dtype=np.float32)
    for index in range(points.shape[1]):
        if flags[index] != 0 and weights[index] > 0.0:
            squared[index], match[index] = search_all(
                points[0, index], points[1, index], target[0], target[1], distances
            )
