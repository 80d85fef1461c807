"""Placement of pedestrians on CUDA: one thread per world."""

from numba import cuda

from navrl.ops.kernels.cuda.launch import thread_per_row
from navrl.ops.kernels.pedestrians import place_pedestrians


@thread_per_row
def place_pedestrians_kernel(worlds, states, route, route_arc, walk, gaits, moves, tick, duration):
    """Place the pedestrians of the listed worlds at their current time."""
    index = cuda.grid(1)
    if index < worlds.shape[0]:
        n = worlds[index]
        place_pedestrians(
            states[n], route[n], route_arc[n], walk[n], gaits[n], moves[n], tick[n] * duration, 0.0
        )
