"""Ray casting, one block per scanner.

Each thread first finds the visible faces of one box; then all threads process all faces, each for
its own beams. No two threads write to the same element, so scans are reproducible.
"""

import math

from numba import cuda, float64, int32

from navrl.ops.kernels.cuda.launch import block_per_row
from navrl.ops.kernels.rays import cast_interval, find_faces

THREADS = 128


@cuda.jit(device=True)
def fill(row, value):
    """Write ``value`` to the beams of this thread."""
    for beam in range(cuda.threadIdx.x, row.shape[0], cuda.blockDim.x):
        row[beam] = value


@cuda.jit(device=True)
def cast_faces(row, begin, end, cos, sin, faces, counts, num_boxes):
    """Cast this thread's share of the beams ``begin .. end - 1`` against all faces found.

    ``faces`` [boxes, 2, 6] and ``counts`` are those of :func:`navrl.ops.kernels.rays.find_faces`.
    """
    for beam in range(begin + cuda.threadIdx.x, end, cuda.blockDim.x):
        for box in range(num_boxes):
            if counts[box] < 0:
                row[beam] = 0.0
            for index in range(counts[box]):
                face = faces[box, index]
                if face[3] <= beam <= face[4] or beam <= face[5]:
                    cast_interval(row, cos, sin, face, beam, beam + 1)


@block_per_row(THREADS)
def cast_rays_kernel(out, pose, boxes, num_boxes, cos, sin, grid, max_range):
    """Scan each world n: its first ``num_boxes[n]`` rows of ``boxes``; NaN rows are absent."""
    n, lane, width = cuda.blockIdx.x, cuda.threadIdx.x, cuda.blockDim.x
    faces = cuda.shared.array((THREADS, 2, 6), float64)
    counts = cuda.shared.array(THREADS, int32)
    x, y, yaw = pose[n, 0], pose[n, 1], pose[n, 2]
    cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
    fill(out[n], max_range)
    for first in range(0, num_boxes[n], width):
        counts[lane] = 0
        if first + lane < num_boxes[n]:
            cx, cy, hx, hy, turn = boxes[n, first + lane]
            if not math.isnan(cx + cy + hx + hy + turn):
                counts[lane] = find_faces(
                    faces[lane], grid, max_range, x, y, cos_yaw, sin_yaw,
                    cx, cy, hx, hy, math.cos(turn), math.sin(turn),
                )  # fmt: skip
        cuda.syncthreads()
        num_found = min(width, num_boxes[n] - first)
        cast_faces(out[n], 0, out.shape[1], cos, sin, faces, counts, num_found)
        cuda.syncthreads()
