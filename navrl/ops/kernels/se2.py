"""Rigid transforms of points in one pass over memory; torch needs six."""

from navrl.ops.kernels.compiler import kernel


@kernel
def transform_points_kernel(rows, points, cos, sin, translation, moved):
    """Write ``points`` [S, N, 2] rotated by [S] and translated by [S, 2] to ``moved``."""
    for n in range(rows[0], rows[1]):
        turn_x, turn_y, x, y = cos[n], sin[n], translation[n, 0], translation[n, 1]
        for index in range(points.shape[1]):
            old_x, old_y = points[n, index, 0], points[n, index, 1]
            moved[n, index, 0] = turn_x * old_x - turn_y * old_y + x
            moved[n, index, 1] = turn_y * old_x + turn_x * old_y + y
