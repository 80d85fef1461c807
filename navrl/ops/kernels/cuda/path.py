"""Path projection and interpolation, one thread per world."""

from numba import cuda

from navrl.ops.kernels.cuda.launch import thread_per_row
from navrl.ops.kernels.path import find_point, project


@thread_per_row
def project_kernel(progress, distance, path, position, previous, ahead, behind):
    """Project each position onto its path; NaN ``previous`` searches the whole path."""
    n = cuda.grid(1)
    if n < progress.shape[0]:
        progress[n], distance[n] = project(path[n], position[n], previous[n], ahead, behind)


@thread_per_row
def points_at_kernel(points, path, arcs):
    """Write the points [N, K, 2] at ``arcs`` [N, K], in any order, along paths [N, P, 2]."""
    n = cuda.grid(1)
    if n < points.shape[0]:
        for j in range(arcs.shape[1]):
            points[n, j, 0], points[n, j, 1] = find_point(path[n], arcs[n, j])
