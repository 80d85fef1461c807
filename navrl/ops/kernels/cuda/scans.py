"""Scans on CUDA: one block per world.

All walls are cast, without the grid of :mod:`navrl.ops.kernels.cells`; the ranges are the same.
"""

import math

from numba import cuda, float64, int32

from navrl.ops.kernels.cuda.launch import block_per_row
from navrl.ops.kernels.cuda.rays import THREADS, cast_faces, fill
from navrl.ops.kernels.pedestrians import first_seen_part, num_parts, shape_of_part
from navrl.ops.kernels.rays import find_faces
from navrl.ops.kernels.scans import first_beam, place_scanner

PARTS = 3  # of a pedestrian: body and two legs


@cuda.jit(device=True)
def seen_shape(shape, index, walls, num_walls, states, walk):
    """Write obstacle ``index``, first walls, then parts of pedestrians; return if it is seen."""
    if index < num_walls:
        for value in range(6):
            shape[value] = walls[index, value]
        return walls[index, 6] > 0.0
    k, part = (index - num_walls) // PARTS, (index - num_walls) % PARTS
    if k >= states.shape[0] or math.isnan(states[k, 4]):
        return False
    if part < first_seen_part(walk[k]) or part >= num_parts(walk[k]):
        return False
    shape_of_part(shape, states[k], walk[k], part)
    return True


@block_per_row(THREADS)
def scan_worlds_kernel(
    out, worlds, pose, mount, walls, num_walls, cell_start, cell_info,
    boxes, walk, newest, sweep, cos, sin, grid, max_range,
):  # fmt: skip
    """Scan the listed worlds from the lidar's mount (x, y, yaw) on their robots."""
    row, n = out[cuda.blockIdx.x], worlds[cuda.blockIdx.x]
    lane, width = cuda.threadIdx.x, cuda.blockDim.x
    faces = cuda.shared.array((THREADS, 2, 6), float64)
    counts = cuda.shared.array(THREADS, int32)
    shape = cuda.local.array(6, float64)
    fill(row, max_range)
    num_boxes, num_sweeps = num_walls[n] + PARTS * boxes.shape[2], sweep[n] + 1
    length = pose.shape[1]
    for part in range(num_sweeps):
        begin = first_beam(part, num_sweeps, row.shape[0])
        end = first_beam(part + 1, num_sweeps, row.shape[0])
        entry = (newest[n] - sweep[n] + part + length) % length
        x, y, cos_yaw, sin_yaw = place_scanner(pose[n, entry], mount)
        for first in range(0, num_boxes, width):
            counts[lane] = 0
            if seen_shape(shape, first + lane, walls[n], num_walls[n], boxes[n, entry], walk[n]):
                counts[lane] = find_faces(
                    faces[lane], grid, max_range, x, y, cos_yaw, sin_yaw,
                    shape[0], shape[1], shape[2], shape[3], shape[4], shape[5],
                )  # fmt: skip
            cuda.syncthreads()
            cast_faces(row, begin, end, cos, sin, faces, counts, min(width, num_boxes - first))
            cuda.syncthreads()
