"""Line fits: kernel of :func:`navrl.ops.lines.fit_lines` for one scan."""

import math

import numpy as np

from navrl.ops.kernels.compiler import reordering_scalar, scalar
from navrl.ops.lines import HALF_WINDOW, MAX_THICKNESS, MIN_POINTS, REACH_M

_FAR = 1e9  # m; coordinate of points without a return


@reordering_scalar
def sum_neighbors(x, y, sums):
    """Write number and moments of the neighbors of each point, relative to it, to ``sums``.

    ``x`` and ``y`` are padded by HALF_WINDOW points on both sides; ``sums`` is [4, N].
    """
    own_x, own_y = x[HALF_WINDOW:], y[HALF_WINDOW:]
    for index in range(sums.shape[1]):
        number, mean_x, mean_y, s_xx, s_yy, s_xy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for offset in range(2 * HALF_WINDOW + 1):
            dx, dy = x[index + offset] - own_x[index], y[index + offset] - own_y[index]
            weight = 1.0 if dx * dx + dy * dy < REACH_M * REACH_M else 0.0
            number += weight
            mean_x += weight * dx
            mean_y += weight * dy
            s_xx += weight * dx * dx
            s_yy += weight * dy * dy
            s_xy += weight * dx * dy
        share = 1.0 / number  # never a division by zero: the point is its own neighbor
        sums[0, index] = number
        sums[1, index] = s_xx - share * mean_x * mean_x
        sums[2, index] = s_yy - share * mean_y * mean_y
        sums[3, index] = s_xy - share * mean_x * mean_y


@scalar
def continue_rows(rows, padded, first, stop):
    """Write the columns ``first .. stop - 1`` of a scan padded circularly to ``padded``.

    ``rows`` [3, M] holds x, y and the weight (1 for a return, else 0); ``padded`` is
    [2, M + 2 HALF_WINDOW].
    """
    count = rows.shape[1]
    for column in range(first, stop):
        index = (column - HALF_WINDOW) % count
        hidden = (1.0 - rows[2, index]) * _FAR * (index + 1)  # distinct, so never neighbors
        padded[0, column], padded[1, column] = rows[0, index] + hidden, rows[1, index]


@scalar
def write_lines(sums, lines):
    """Write x and y of the normal and whether a line fits to ``lines`` [3, M or more]."""
    for index in range(sums.shape[1]):
        number, s_xx, s_yy, s_xy = sums[0, index], sums[1, index], sums[2, index], sums[3, index]
        half_sum, half_difference = 0.5 * (s_xx + s_yy), 0.5 * (s_xx - s_yy)
        spread = math.sqrt(half_difference * half_difference + s_xy * s_xy)
        is_line = number >= MIN_POINTS and half_sum - spread < MAX_THICKNESS * (half_sum + spread)
        # half-angle formulas; cosine and sine of the full angle are half_difference / spread and
        # s_xy / spread
        larger = math.sqrt(0.5 * (1.0 + abs(half_difference) / spread))
        smaller = 0.5 * abs(s_xy) / (spread * larger)
        is_along_x = half_difference > 0.0
        sine, cosine = (smaller, larger) if is_along_x else (larger, smaller)
        lines[0, index] = -math.copysign(sine, s_xy) if is_line else 0.0
        lines[1, index] = cosine if is_line else 1.0
        lines[2, index] = 1.0 if is_line else 0.0


@scalar
def fit_lines(rows, lines):
    """Write the line through each point of ``rows`` [3, M] to ``lines`` [3, M or more]."""
    padded = np.empty((2, rows.shape[1] + 2 * HALF_WINDOW))
    continue_rows(rows, padded, 0, padded.shape[1])
    sums = np.empty((4, rows.shape[1]))
    sum_neighbors(padded[0], padded[1], sums)
    write_lines(sums, lines)
