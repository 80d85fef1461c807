"""Walls by cells of a grid, so that scans and contact checks visit only near ones.

A world with few walls has no grid. Walls are sorted by the cell of their center; those that do not
fit a cell come first. Arrays, one row per world:

========== =========== =============================================================
cell_info  [N, 5]      x, y of the grid's corner, size of a cell, cells along x and y; 0
                       cells without a grid
cell_start [N, C + 2]  first wall of each cell, cell (i, j) at 1 + i * cells along y + j; entry 0
                       is that of the walls that do not fit a cell
========== =========== =============================================================

A wall fits a cell if half its diagonal is at most half a cell. A scan visits the cells in rings
around the scanner, near ones first, and ends when all beams are shorter than the distance of the
next ring. Within a ring, walls behind the ranges so far are skipped. Neither changes a range: a
skipped wall is farther than all ranges that it could change.
"""

from __future__ import annotations

import math

import numpy as np

from navrl.ops.kernels.compiler import scalar, unordered_scalar
from navrl.ops.kernels.rays import cast_box

BLOCK = 16  # beams; the largest range of a block is compared with the distance of a wall
ANGLE_ERROR = 0.005  # rad, above that of rough_atan2
SLACK_M = 1e-3  # m, above the rounding of float32 ranges


@unordered_scalar
def largest_of(row: np.ndarray, first: int, stop: int) -> np.float32:
    """Return the largest of ``row[first:stop]``, which has no NaN; -infinity without any."""
    found = np.float32(-np.inf)
    for beam in range(first, stop):
        found = max(found, row[beam])
    return found


@scalar
def farthest(row: np.ndarray, begin: int, end: int, blocks: np.ndarray) -> np.float32:
    """Write the largest range of each block of beams; return the largest of all.

    Beams outside of ``begin .. end - 1`` are ignored; a block without others has -infinity.
    """
    largest = np.float32(-np.inf)
    for block in range(begin // BLOCK, (end - 1) // BLOCK + 1):
        found = largest_of(row, max(block * BLOCK, begin), min((block + 1) * BLOCK, end))
        blocks[block] = found
        largest = max(largest, found)
    return largest


@scalar
def rough_atan2(y: float, x: float) -> float:
    """Return the angle of (x, y) with an error of at most 0.004 rad, at a fraction of the time."""
    large, small = max(abs(x), abs(y)), min(abs(x), abs(y))
    ratio = small / large if large > 0.0 else 0.0
    angle = ratio * (0.25 * math.pi + 0.273 * (1.0 - ratio))
    if abs(y) > abs(x):
        angle = 0.5 * math.pi - angle
    if x < 0.0:
        angle = math.pi - angle
    return math.copysign(angle, y)


@scalar
def is_hidden(
    blocks: np.ndarray, begin: int, end: int, grid: tuple[float, float, float], px: float,
    py: float, distance: float, extent: float,
) -> bool:  # fmt: skip
    """Return whether a wall is behind the ranges of all beams that could meet it.

    Args:
        blocks: Largest range of each block, see :func:`farthest`.
        begin, end: beams of this part of the scan.
        grid: See :func:`navrl.ops.kernels.rays.write_face`.
        px, py: center of the wall, scanner frame.
        distance: Distance of that center.
        extent: Half diagonal of the wall.
    """
    gap = distance - extent - SLACK_M
    if gap <= 0.0:
        return False
    angle_min, beams_per_rad, period = grid
    # asin(x) <= pi / 2 * x, and one beam more for rounding
    half = (0.5 * math.pi * extent / distance + ANGLE_ERROR) * abs(beams_per_rad) + 1.0
    middle = (rough_atan2(py, px) - angle_min) * beams_per_rad
    for turn in range(-1, 2):
        first = max(math.floor(middle - half + turn * period), begin)
        last = min(math.ceil(middle + half + turn * period), end - 1)
        for block in range(first // BLOCK, last // BLOCK + 1 if first <= last else 0):
            if blocks[block] > gap:
                return False
    return True


@scalar
def cast_walls(
    row: np.ndarray, begin: int, end: int, cos: np.ndarray, sin: np.ndarray,
    grid: tuple[float, float, float], faces: np.ndarray, max_range: float, x: float, y: float,
    cos_yaw: float, sin_yaw: float, walls: np.ndarray, num_walls: int, cell_start: np.ndarray,
    cell_info: np.ndarray, blocks: np.ndarray,
) -> None:  # fmt: skip
    """Write the ranges to all walls that the lidar sees into ``row[begin:end]``.

    ``faces`` [2, 6] and ``blocks`` are scratch.
    """
    if cell_info[3] == 0.0:
        for wall in range(num_walls):
            cx, cy, hx, hy, cos_box, sin_box, is_seen, _ = walls[wall]
            if is_seen > 0.0:
                cast_box(
                    row, begin, end, cos, sin, grid, faces, max_range, x, y, cos_yaw, sin_yaw,
                    cx, cy, hx, hy, cos_box, sin_box,
                )  # fmt: skip
        return
    size = cell_info[2]
    columns, lines = int(cell_info[3]), int(cell_info[4])
    i = math.floor((x - cell_info[0]) / size)
    j = math.floor((y - cell_info[1]) / size)
    blocks[:] = max_range
    scanner = (x, y, cos_yaw, sin_yaw)
    cast_listed(
        row, begin, end, cos, sin, grid, faces, max_range, scanner, walls, blocks,
        0, cell_start[1],
    )  # fmt: skip
    ring = 0
    while True:
        if ring != 1 and (ring - 1.5) * size >= farthest(row, begin, end, blocks):
            return
        for column in range(max(i - ring, 0), min(i + ring + 1, columns)):
            is_side = abs(column - i) == ring
            stride = 1 if is_side or ring == 0 else 2 * ring
            for line in range(j - ring, j + ring + 1, stride):
                if 0 <= line < lines:
                    cell = column * lines + line + 1
                    cast_listed(
                        row, begin, end, cos, sin, grid, faces, max_range, scanner, walls, blocks,
                        cell_start[cell], cell_start[cell + 1],
                    )  # fmt: skip
        ring += 1


@scalar
def cast_listed(
    row: np.ndarray, begin: int, end: int, cos: np.ndarray, sin: np.ndarray,
    grid: tuple[float, float, float], faces: np.ndarray, max_range: float,
    scanner: tuple[float, float, float, float], walls: np.ndarray, blocks: np.ndarray, first: int,
    stop: int,
) -> None:  # fmt: skip
    """Write the ranges to the walls ``walls[first:stop]`` that are not hidden."""
    x, y, cos_yaw, sin_yaw = scanner
    for index in range(first, stop):
        cx, cy, hx, hy, cos_box, sin_box, is_seen, _ = walls[index]
        if is_seen == 0.0:
            continue
        dx, dy = cx - x, cy - y
        distance, extent = math.sqrt(dx * dx + dy * dy), math.sqrt(hx * hx + hy * hy)
        if distance - extent >= max_range:
            continue
        px, py = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
        if is_hidden(blocks, begin, end, grid, px, py, distance, extent):
            continue
        cast_box(
            row, begin, end, cos, sin, grid, faces, max_range, x, y, cos_yaw, sin_yaw,
            cx, cy, hx, hy, cos_box, sin_box,
        )  # fmt: skip


@scalar
def wall_in_reach(x: float, y: float, reach: float, wall: np.ndarray) -> bool:
    """Return whether a touchable wall may come within ``reach`` of (x, y), by its diagonal."""
    dx, dy = wall[0] - x, wall[1] - y
    extent = math.sqrt(wall[2] * wall[2] + wall[3] * wall[3]) + reach
    return wall[7] > 0.0 and dx * dx + dy * dy <= extent * extent


@scalar
def cell_range(offset: float, margin: float, size: float, count: int) -> tuple[int, int]:
    """Return the first cell and the end of those within ``margin`` of a coordinate."""
    first = math.floor((offset - margin) / size)
    last = math.floor((offset + margin) / size)
    return max(first, 0), min(last + 1, count)


@scalar
def list_near_walls(
    x: float, y: float, reach: float, walls: np.ndarray, num_walls: int, cell_start: np.ndarray,
    cell_info: np.ndarray, near: np.ndarray,
) -> int:  # fmt: skip
    """Write the indices of walls that may be within ``reach`` of (x, y); return their number."""
    count = 0
    if cell_info[3] == 0.0:
        for wall in range(num_walls):
            if wall_in_reach(x, y, reach, walls[wall]):
                near[count] = wall
                count += 1
        return count
    for index in range(cell_start[1]):
        if wall_in_reach(x, y, reach, walls[index]):
            near[count] = index
            count += 1
    size, columns, lines = cell_info[2], int(cell_info[3]), int(cell_info[4])
    margin = reach + 0.5 * size  # a wall reaches half a cell beyond the cell of its center
    first, last = cell_range(x - cell_info[0], margin, size, columns)
    low, high = cell_range(y - cell_info[1], margin, size, lines)
    for column in range(first, last):
        for line in range(low, high):
            cell = column * lines + line + 1
            for index in range(cell_start[cell], cell_start[cell + 1]):
                if wall_in_reach(x, y, reach, walls[index]):
                    near[count] = index
                    count += 1
    return count
