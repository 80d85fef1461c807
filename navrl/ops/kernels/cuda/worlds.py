"""Steps on CUDA: one thread per world."""

from numba import cuda, float64

from navrl.ops.contact import NONE
from navrl.ops.kernels.cuda.launch import thread_per_row
from navrl.ops.kernels.worlds import step_world


@thread_per_row
def step_worlds_kernel(
    pose, velocity, tick, contact, command, track, drive, timing, walls, num_walls,
    cell_start, cell_info, route, route_arc, walk, gaits, moves, boxes, near,
    past_pose, past_boxes, present, scan_age, sweep,
):  # fmt: skip
    """Advance all worlds that are not in contact; ``near`` [N, W + K] is scratch."""
    n = cuda.grid(1)
    shape = cuda.local.array(6, float64)
    if n < pose.shape[0] and contact[n] == NONE:
        tick[n], contact[n] = step_world(
            pose[n], velocity[n], tick[n], command[n], track[n], drive, timing,
            walls[n], num_walls[n], cell_start[n], cell_info[n], route[n],
            route_arc[n], walk[n], gaits[n], moves[n], boxes[n], near[n], shape, past_pose[n],
            past_boxes[n], present[n], scan_age[n], sweep[n],
        )  # fmt: skip
