"""Projection onto paths and points along them, one path a world."""

import math

from numba import prange

from navrl.ops.kernels.compiler import kernel


@kernel
def project_kernel(progress, distance, path, position, previous, ahead, behind):
    """Write where each position lies on its path; NaN ``previous`` searches all of it.

    Arrays: progress, distance, previous [N]; path [N, P, 2]; position [N, 2].
    """
    for n in prange(path.shape[0]):
        px, py = position[n]
        total = 0.0
        for k in range(path.shape[1] - 1):
            dx, dy = path[n, k + 1, 0] - path[n, k, 0], path[n, k + 1, 1] - path[n, k, 1]
            total += math.sqrt(dx * dx + dy * dy)
        is_anywhere = math.isnan(previous[n])
        last = 0.0 if is_anywhere else min(float(previous[n]), total)
        lowest = -math.inf if is_anywhere else last - behind
        highest = math.inf if is_anywhere else last + ahead
        best, best_arc, arc = math.inf, 0.0, 0.0
        for k in range(path.shape[1] - 1):
            dx, dy = path[n, k + 1, 0] - path[n, k, 0], path[n, k + 1, 1] - path[n, k, 1]
            length = math.sqrt(dx * dx + dy * dy)
            if arc + length >= lowest:
                low = min(max(lowest - arc, 0.0), length)
                high = max(min(highest - arc, length), low)
                ox, oy = px - path[n, k, 0], py - path[n, k, 1]
                along = (ox * dx + oy * dy) / max(length, 1e-9)
                along = min(max(along, low), high)
                share = along / max(length, 1e-9)
                ex, ey = ox - share * dx, oy - share * dy
                squared = ex * ex + ey * ey
                if squared < best:
                    best, best_arc = squared, arc + along
            arc += length
            if arc > highest:
                break
        progress[n], distance[n] = best_arc, math.sqrt(best)


@kernel
def points_at_kernel(points, path, arcs):
    """Write the points [N, K, 2] at ``arcs`` [N, K], in any order, along paths [N, P, 2]."""
    last = path.shape[1] - 1
    for n in prange(path.shape[0]):
        for j in range(arcs.shape[1]):
            left = max(float(arcs[n, j]), 0.0)
            points[n, j, 0], points[n, j, 1] = path[n, last, 0], path[n, last, 1]
            for k in range(last):
                dx, dy = path[n, k + 1, 0] - path[n, k, 0], path[n, k + 1, 1] - path[n, k, 1]
                length = math.sqrt(dx * dx + dy * dy)
                if left < length:
                    share = left / length
                    points[n, j, 0] = path[n, k, 0] + share * dx
                    points[n, j, 1] = path[n, k, 1] + share * dy
                    break
                left -= length
