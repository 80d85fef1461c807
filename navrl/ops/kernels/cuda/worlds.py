"""Simulation on CUDA: one thread per world for steps, one block per world for scans."""

import math

from numba import cuda, float64, int32

from navrl.ops.contact import NONE
from navrl.ops.kernels.cuda.launch import block_per_row, thread_per_row
from navrl.ops.kernels.cuda.rays import THREADS, cast_faces, fill
from navrl.ops.kernels.pedestrians import place_pedestrians
from navrl.ops.kernels.rays import find_faces
from navrl.ops.kernels.worlds import first_beam, place_scanner, step_world


@thread_per_row
def step_worlds_kernel(
    pose, velocity, tick, contact, command, track, drive, timing, walls, num_walls,
    route, route_arc, walk, legs, boxes, near, past_pose, past_boxes, present, scan_age, sweep,
):  # fmt: skip
    """Advance all worlds that are not in contact; ``near`` [N, W + K] is scratch."""
    n = cuda.grid(1)
    if n < pose.shape[0] and contact[n] == NONE:
        tick[n], contact[n] = step_world(
            pose[n], velocity[n], tick[n], command[n], track[n], drive, timing,
            walls[n], num_walls[n], route[n], route_arc[n], walk[n], legs[n], boxes[n], near[n],
            past_pose[n], past_boxes[n], present[n], scan_age[n], sweep[n],
        )  # fmt: skip


@thread_per_row
def place_pedestrians_kernel(worlds, boxes, route, route_arc, walk, legs, tick, duration):
    """Place the pedestrians of the listed worlds at their current time."""
    index = cuda.grid(1)
    if index < worlds.shape[0]:
        n = worlds[index]
        place_pedestrians(
            boxes[n], route[n], route_arc[n], walk[n], legs[n], tick[n] * duration, 0.0
        )


@block_per_row(THREADS)
def scan_worlds_kernel(
    out, worlds, pose, mount, walls, num_walls, boxes, newest, sweep, cos, sin, grid, max_range
):
    """Scan the listed worlds from the lidar's mount (x, y, yaw) on their robots."""
    row, n = out[cuda.blockIdx.x], worlds[cuda.blockIdx.x]
    lane, width = cuda.threadIdx.x, cuda.blockDim.x
    faces = cuda.shared.array((THREADS, 2, 6), float64)
    counts = cuda.shared.array(THREADS, int32)
    fill(row, max_range)
    num_boxes, num_parts, length = num_walls[n] + boxes.shape[2], sweep[n] + 1, pose.shape[1]
    for part in range(num_parts):
        begin = first_beam(part, num_parts, row.shape[0])
        end = first_beam(part + 1, num_parts, row.shape[0])
        entry = (newest[n] - sweep[n] + part + length) % length
        x, y, cos_yaw, sin_yaw = place_scanner(pose[n, entry], mount)
        for first in range(0, num_boxes, width):
            box = first + lane
            counts[lane] = 0
            if box < num_walls[n]:
                cx, cy, hx, hy, cos_box, sin_box = walls[n, box]
                counts[lane] = find_faces(
                    faces[lane], grid, max_range, x, y, cos_yaw, sin_yaw,
                    cx, cy, hx, hy, cos_box, sin_box,
                )  # fmt: skip
            elif box < num_boxes:
                cx, cy, hx, hy, turn = boxes[n, entry, box - num_walls[n]]
                if not math.isnan(turn):
                    counts[lane] = find_faces(
                        faces[lane], grid, max_range, x, y, cos_yaw, sin_yaw,
                        cx, cy, hx, hy, math.cos(turn), math.sin(turn),
                    )  # fmt: skip
            cuda.syncthreads()
            cast_faces(row, begin, end, cos, sin, faces, counts, min(width, num_boxes - first))
            cuda.syncthreads()
