"""Path projection and interpolation: kernels of :mod:`navrl.ops.path`, one path per world."""

import math

from torch import Tensor

from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.operators import operator
from navrl.ops.path_search import LEAVING_RATIO

_LEAVING_SQUARED = LEAVING_RATIO**2


@scalar
def project(path, position, previous, ahead, behind):
    """Return arc length and distance of the projection of a position on a path [P, 2]."""
    px, py = position[0], position[1]
    total = 0.0
    for k in range(path.shape[0] - 1):
        dx, dy = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1]
        total += math.sqrt(dx * dx + dy * dy)
    is_anywhere = math.isnan(previous)
    last = 0.0 if is_anywhere else min(float(previous), total)
    lowest = -math.inf if is_anywhere else last - behind
    highest = math.inf if is_anywhere else last + ahead
    best, best_arc, arc = math.inf, 0.0, 0.0
    nearest_ahead = math.inf
    for k in range(path.shape[0] - 1):
        dx, dy = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if arc + length >= lowest:
            low = min(max(lowest - arc, 0.0), length)
            high = max(min(highest - arc, length), low)
            ox, oy = px - path[k, 0], py - path[k, 1]
            along = (ox * dx + oy * dy) / max(length, 1e-9)
            along = min(max(along, low), high)
            share = along / max(length, 1e-9)
            ex, ey = ox - share * dx, oy - share * dy
            squared = ex * ex + ey * ey
            if squared < best:
                best, best_arc = squared, arc + along
            if not is_anywhere and arc + length >= last:
                nearest_ahead = min(nearest_ahead, squared)
                share = high / max(length, 1e-9)
                ex, ey = ox - share * dx, oy - share * dy
                if ex * ex + ey * ey > _LEAVING_SQUARED * nearest_ahead:
                    break  # the following segments belong to another branch
        arc += length
        if arc > highest:
            break
    return best_arc, math.sqrt(best)


@scalar
def find_point(path, arc):
    """Return the point at an arc length along a path [P, 2], clamped to its ends."""
    last = path.shape[0] - 1
    left = max(float(arc), 0.0)
    for k in range(last):
        dx, dy = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1]
        length = math.sqrt(dx * dx + dy * dy)
        if left < length:
            share = left / length
            return path[k, 0] + share * dx, path[k, 1] + share * dy
        left -= length
    return float(path[last, 0]), float(path[last, 1])


@kernel
def project_kernel(rows, progress, distance, path, position, previous, ahead, behind):
    """Project each position onto its path; NaN ``previous`` searches the whole path.

    Arrays: progress, distance, previous [N]; path [N, P, 2]; position [N, 2].
    """
    for n in range(rows[0], rows[1]):
        progress[n], distance[n] = project(path[n], position[n], previous[n], ahead, behind)


@kernel
def points_at_kernel(rows, points, path, arcs):
    """Write the points [N, K, 2] at ``arcs`` [N, K], in any order, along paths [N, P, 2]."""
    for n in range(rows[0], rows[1]):
        for j in range(arcs.shape[1]):
            points[n, j, 0], points[n, j, 1] = find_point(path[n], arcs[n, j])


def _projected(path: Tensor, *_: object) -> tuple[Tensor, Tensor]:
    return path.new_empty(path.shape[0]), path.new_empty(path.shape[0])


@operator(_projected)
def project_rows(
    path: Tensor, position: Tensor, previous: Tensor, ahead: float, behind: float
) -> tuple[Tensor, Tensor]:
    """Run the kernel of :func:`navrl.ops.path.project_onto_path`; return progress and distance."""
    progress, distance = _projected(path)
    arrays = (path.contiguous(), position.contiguous(), previous.contiguous())
    project_kernel(progress, distance, *arrays, ahead, behind)
    return progress, distance


def _points(path: Tensor, arcs: Tensor) -> Tensor:
    return path.new_empty(*arcs.shape, 2)


@operator(_points)
def points_at(path: Tensor, arcs: Tensor) -> Tensor:
    """Run the kernel of :func:`navrl.ops.path.point_at`; return the points [N, K, 2]."""
    points = _points(path, arcs)
    points_at_kernel(points, path.contiguous(), arcs.contiguous())
    return points
