"""Ray casting by rasterizing box faces and discs into intervals of beams.

At most two faces of a box are visible to a scanner outside of it, and each face covers one interval
of beams, as does a disc. The cost per box is therefore two to four arc tangents and one division
per covered beam, instead of one slab test per beam and box.

A disc is an obstacle without a direction: its cosine and sine are zero and hx is its radius.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.operators import operator

_EDGE = 1e-9  # beams; widens faces so that no beam passes between two boxes with a common corner


@scalar
def write_face(face, grid, distance, nx, ny, start_x, start_y, end_x, end_y):
    """Write a face seen from its outside as (distance, nx, ny, first, last, last after a turn).

    A disc is written as (-radius, x, y, first, last, last after a turn), its center in the scanner
    frame.

    Args:
        face: [6]; beams ``first .. last`` meet it, and beams ``0 .. last after a turn``, if any. An
            index may lie beyond the scan's beams.
        grid: (angle of beam 0, rad; beams a radian, negative if they are counted clockwise; beams
            that a full circle would hold).
        distance: Distance of the scanner from the face's line, positive.
        nx, ny: unit normal pointing from the scanner to the face's line, scanner frame.
        start_x .. end_y: the face's corners in the scanner frame, counter-clockwise, or points in
            the directions of a disc's tangents.
    """
    angle_min, beams_per_rad, period = grid
    start = (math.atan2(start_y, start_x) - angle_min) * beams_per_rad
    end = (math.atan2(end_y, end_x) - angle_min) * beams_per_rad
    if beams_per_rad < 0.0:
        start, end = end, start
    if end < start:
        end += period
    if math.ceil(start - _EDGE) < 0:
        start, end = start + period, end + period
    face[0], face[1], face[2] = distance, nx, ny
    face[3], face[4] = math.ceil(start - _EDGE), math.floor(end + _EDGE)
    face[5] = math.floor(end - period + _EDGE)


@scalar
def find_disc(
    face: np.ndarray, grid: tuple[float, float, float], max_range: float, dx: float, dy: float,
    cos_yaw: float, sin_yaw: float, radius: float,
) -> int:  # fmt: skip
    """Write a disc with center (dx, dy) from the scanner, world frame; return as find_faces."""
    distance = math.sqrt(dx * dx + dy * dy)
    if distance - radius >= max_range:
        return 0
    if distance <= radius:
        return -1
    px, py = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
    sin = radius / distance  # of half the angle that the disc covers
    cos = math.sqrt(1.0 - sin * sin)
    write_face(
        face, grid, -radius, px, py,
        cos * px + sin * py, cos * py - sin * px, cos * px - sin * py, cos * py + sin * px,
    )  # fmt: skip
    return 1


@scalar
def find_faces(faces, grid, max_range, x, y, cos_yaw, sin_yaw, cx, cy, hx, hy, cos_box, sin_box):
    """Write the faces of a box that are visible to a scanner; see :func:`write_face`.

    The scanner is at (x, y) with the given heading, world frame.

    Returns:
        The number of faces: 0 for a box farther than ``max_range``, -1 for a box that contains the
        scanner, which then reads 0 in all beams.
    """
    dx, dy = cx - x, cy - y
    if cos_box == 0.0 and sin_box == 0.0:
        return find_disc(faces[0], grid, max_range, dx, dy, cos_yaw, sin_yaw, hx)
    # the scanner in the box frame
    qx = -(cos_box * dx + sin_box * dy)
    qy = -(cos_box * dy - sin_box * dx)
    gap_x, gap_y = abs(qx) - hx, abs(qy) - hy
    outside_x, outside_y = max(gap_x, 0.0), max(gap_y, 0.0)
    if outside_x * outside_x + outside_y * outside_y >= max_range * max_range:
        return 0
    if gap_x <= 0.0 and gap_y <= 0.0:
        return -1
    # center and axes of the box in the scanner frame
    px, py = cos_yaw * dx + sin_yaw * dy, cos_yaw * dy - sin_yaw * dx
    ux, uy = cos_box * cos_yaw + sin_box * sin_yaw, sin_box * cos_yaw - cos_box * sin_yaw
    count = 0
    if 0.0 < gap_x < max_range:
        side = math.copysign(1.0, qx)
        mx, my = px + side * hx * ux, py + side * hx * uy
        tx, ty = -side * hy * uy, side * hy * ux
        nx, ny = -side * ux, -side * uy
        write_face(faces[count], grid, gap_x, nx, ny, mx + tx, my + ty, mx - tx, my - ty)
        count += 1
    if 0.0 < gap_y < max_range:
        side = math.copysign(1.0, qy)
        mx, my = px - side * hy * uy, py + side * hy * ux
        tx, ty = -side * hx * ux, -side * hx * uy
        nx, ny = side * uy, -side * ux
        write_face(faces[count], grid, gap_y, nx, ny, mx + tx, my + ty, mx - tx, my - ty)
        count += 1
    return count


@scalar
def cast_box(
    out: np.ndarray, begin: int, end: int, cos: np.ndarray, sin: np.ndarray,
    grid: tuple[float, float, float], faces: np.ndarray, max_range: float, x: float, y: float,
    cos_yaw: float, sin_yaw: float, cx: float, cy: float, hx: float, hy: float, cos_box: float,
    sin_box: float,
) -> None:  # fmt: skip
    """Write the ranges to one box into the beams ``begin .. end - 1`` of ``out`` [beams].

    ``faces`` [2, 6] is scratch.
    """
    count = find_faces(
        faces, grid, max_range, x, y, cos_yaw, sin_yaw, cx, cy, hx, hy, cos_box, sin_box
    )
    if count < 0:
        out[begin:end] = 0.0
    for index in range(count):
        face = faces[index]
        first, last, wrapped = int(face[3]), int(face[4]), int(face[5])
        cast_interval(out, cos, sin, face, max(first, begin), min(last + 1, end))
        cast_interval(out, cos, sin, face, begin, min(wrapped + 1, end))


@scalar
def cast_interval(
    out: np.ndarray, cos: np.ndarray, sin: np.ndarray, face: np.ndarray, first: int, stop: int
) -> None:
    """Write the ranges to one face or disc into the beams ``first .. stop - 1`` of ``out``."""
    distance, nx, ny = face[0], face[1], face[2]
    if distance < 0.0:
        cast_disc(out, cos, sin, face, first, stop)
        return
    for beam in range(first, stop):
        towards = nx * cos[beam] + ny * sin[beam]
        reach = np.float32(distance / towards)
        if towards > 0.0 and reach < out[beam]:
            out[beam] = reach


@scalar
def cast_disc(
    out: np.ndarray, cos: np.ndarray, sin: np.ndarray, face: np.ndarray, first: int, stop: int
) -> None:
    """Write the ranges to one disc into the beams ``first .. stop - 1`` of ``out``."""
    radius, px, py = -face[0], face[1], face[2]
    for beam in range(first, stop):
        along = px * cos[beam] + py * sin[beam]
        across = px * sin[beam] - py * cos[beam]
        inside = radius * radius - across * across
        if along > 0.0 and inside >= 0.0:
            reach = np.float32(along - math.sqrt(inside))
            if reach < out[beam]:
                out[beam] = reach


@kernel
def cast_rays_kernel(rows, out, pose, boxes, num_boxes, cos, sin, grid, max_range):
    """Scan each world n: its first ``num_boxes[n]`` rows of ``boxes``; NaN rows are absent."""
    for world in range(rows[0], rows[1]):
        row, faces = out[world], np.empty((2, 6))
        row[:] = max_range
        x, y, yaw = pose[world, 0], pose[world, 1], pose[world, 2]
        cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
        for box in range(num_boxes[world]):
            cx, cy, hx, hy, turn = boxes[world, box]
            if math.isnan(cx + cy + hx + hy + turn):
                continue
            cos_box, sin_box = math.cos(turn), math.sin(turn)
            cast_box(
                row, 0, row.shape[0], cos, sin, grid, faces, max_range, x, y, cos_yaw, sin_yaw,
                cx, cy, hx, hy, cos_box, sin_box,
            )  # fmt: skip


def _cast(pose: Tensor, boxes: Tensor, num_boxes: Tensor, beams: Tensor, *_: object) -> Tensor:
    return pose.new_empty(pose.shape[0], beams.shape[1], dtype=torch.float32)


@operator(_cast, shared=["beams"])
def cast_rows(
    pose: Tensor,
    boxes: Tensor,
    num_boxes: Tensor,
    beams: Tensor,
    grid: Sequence[float],
    max_range: float,
) -> Tensor:
    """Run the kernel of :func:`navrl.ops.raycast.cast_rays`; ``beams`` [2, beams] (cos, sin)."""
    ranges = _cast(pose, boxes, num_boxes, beams)
    rows = (pose.contiguous(), boxes.contiguous(), num_boxes.contiguous())
    cast_rays_kernel(ranges, *rows, *beams, tuple(grid), max_range)
    return ranges
