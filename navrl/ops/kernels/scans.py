"""Batched simulation kernel: scan all worlds; arrays as in :mod:`navrl.ops.kernels.worlds`."""

from __future__ import annotations

import math

import numpy as np

from navrl.ops.beams import first_beam
from navrl.ops.kernels.cells import BLOCK, cast_walls
from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.pedestrians import first_seen_part, num_parts, shape_of_part
from navrl.ops.kernels.rays import cast_box

first_beam = scalar(first_beam)


@scalar
def place_scanner(pose: np.ndarray, mount: np.ndarray) -> tuple[float, float, float, float]:
    """Return (x, y, cos, sin) of a lidar mounted at (x, y, yaw) on a robot."""
    cos_robot, sin_robot = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + cos_robot * mount[0] - sin_robot * mount[1]
    y = pose[1] + sin_robot * mount[0] + cos_robot * mount[1]
    return x, y, math.cos(pose[2] + mount[2]), math.sin(pose[2] + mount[2])


@scalar
def cast_pedestrians(
    row: np.ndarray, begin: int, end: int, cos: np.ndarray, sin: np.ndarray,
    grid: tuple[float, float, float], faces: np.ndarray, max_range: float, x: float, y: float,
    cos_yaw: float, sin_yaw: float, states: np.ndarray, walk: np.ndarray, shape: np.ndarray,
) -> None:  # fmt: skip
    """Write the ranges to all pedestrians into ``row[begin:end]``; ``shape`` [6] is scratch."""
    for k in range(states.shape[0]):
        if math.isnan(states[k, 4]):
            continue
        for part in range(first_seen_part(walk[k]), num_parts(walk[k])):
            shape_of_part(shape, states[k], walk[k], part)
            cast_box(
                row, begin, end, cos, sin, grid, faces, max_range, x, y, cos_yaw, sin_yaw,
                shape[0], shape[1], shape[2], shape[3], shape[4], shape[5],
            )  # fmt: skip


@kernel
def scan_worlds_kernel(
    rows: tuple[int, int], out: np.ndarray, worlds: np.ndarray, pose: np.ndarray, mount: np.ndarray,
    walls: np.ndarray, num_walls: np.ndarray, cell_start: np.ndarray, cell_info: np.ndarray,
    boxes: np.ndarray, walk: np.ndarray, newest: np.ndarray, sweep, cos: np.ndarray,
    sin: np.ndarray, grid: tuple[float, float, float], max_range: float,
) -> None:  # fmt: skip
    """Scan the listed worlds from the lidar's mount (x, y, yaw) on their robots.

    ``pose`` [N, L, 3] and ``boxes`` [N, L, K, 7] are rings of L substeps. The last beam sees entry
    ``newest`` [N], the first beam the entry ``sweep`` [N] substeps before it.
    """
    shape, blocks = np.empty(6), np.empty((out.shape[1] + BLOCK - 1) // BLOCK)
    for index in range(rows[0], rows[1]):
        n, row, faces = worlds[index], out[index], np.empty((2, 6))
        num_sweeps, length = sweep[n] + 1, pose.shape[1]
        row[:] = max_range
        for part in range(num_sweeps):
            begin = first_beam(part, num_sweeps, row.shape[0])
            end = first_beam(part + 1, num_sweeps, row.shape[0])
            entry = (newest[n] - sweep[n] + part + length) % length
            x, y, cos_yaw, sin_yaw = place_scanner(pose[n, entry], mount)
            cast_pedestrians(
                row, begin, end, cos, sin, grid, faces, max_range, x, y, cos_yaw, sin_yaw,
                boxes[n, entry], walk[n], shape,
            )  # fmt: skip
            cast_walls(
                row, begin, end, cos, sin, grid, faces, max_range, x, y, cos_yaw, sin_yaw,
                walls[n], num_walls[n], cell_start[n], cell_info[n], blocks,
            )  # fmt: skip
