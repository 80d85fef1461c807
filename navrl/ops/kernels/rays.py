"""Ray casting by rasterizing box faces into intervals of beams.

At most two faces of a box are visible to a scanner outside of it, and each face covers one interval
of beams. The cost per box is therefore two to four arc tangents and one division per covered beam,
instead of one slab test per beam and box.
"""

import math

import numpy as np

from navrl.ops.kernels.compiler import kernel, scalar

_EDGE = 1e-9  # beams; widens faces so that no beam passes between two boxes with a common corner


@scalar
def write_face(face, num_beams, distance, nx, ny, start_x, start_y, end_x, end_y):
    """Write a visible face as (distance, nx, ny, first beam, last beam).

    Args:
        face: [5], output; the last beam may be beyond ``num_beams``, where indices wrap to 0.
        num_beams: Number of beams over the full circle.
        distance: Distance of the scanner from the line of the face, m, positive.
        nx, ny: Unit normal from the scanner to the line of the face, scanner frame.
        start_x .. end_y: Corners of the face in the scanner frame, m, counter-clockwise.
    """
    beams_per_rad = num_beams / (2.0 * math.pi)
    start = math.atan2(start_y, start_x) * beams_per_rad
    end = math.atan2(end_y, end_x) * beams_per_rad
    if end < start:
        end += num_beams
    turn = num_beams if math.ceil(start - _EDGE) < 0 else 0
    face[0], face[1], face[2] = distance, nx, ny
    face[3], face[4] = math.ceil(start - _EDGE) + turn, math.floor(end + _EDGE) + turn


@scalar
def find_faces(
    faces, num_beams, max_range, x, y, cos_yaw, sin_yaw, cx, cy, hx, hy, cos_box, sin_box
):
    """Write the faces of a box visible to a scanner to ``faces`` [2, 5], see :func:`write_face`.

    The scanner is at (x, y) with the given heading, world frame.

    Returns:
        The number of faces: 0 for a box farther than ``max_range``, -1 for a box that contains the
        scanner, which then reads 0 in all beams.
    """
    dx, dy = cx - x, cy - y
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
        write_face(faces[count], num_beams, gap_x, nx, ny, mx + tx, my + ty, mx - tx, my - ty)
        count += 1
    if 0.0 < gap_y < max_range:
        side = math.copysign(1.0, qy)
        mx, my = px - side * hy * uy, py + side * hy * ux
        tx, ty = -side * hx * ux, -side * hx * uy
        nx, ny = side * uy, -side * ux
        write_face(faces[count], num_beams, gap_y, nx, ny, mx + tx, my + ty, mx - tx, my - ty)
        count += 1
    return count


@scalar
def cast_box(
    out, cos, sin, faces, max_range, x, y, cos_yaw, sin_yaw, cx, cy, hx, hy, cos_box, sin_box
):
    """Write the ranges to one box into ``out`` [beams]; ``faces`` [2, 5] is scratch."""
    count = find_faces(
        faces, out.shape[0], max_range, x, y, cos_yaw, sin_yaw, cx, cy, hx, hy, cos_box, sin_box
    )
    if count < 0:
        out[:] = 0.0
    for index in range(count):
        face = faces[index]
        first, last = int(face[3]), int(face[4])
        cast_interval(out, cos, sin, face, first, min(last + 1, out.shape[0]))
        cast_interval(out, cos, sin, face, 0, last + 1 - out.shape[0])


@scalar
def cast_interval(out, cos, sin, face, first, stop):
    """Write the ranges to one face into the beams ``first .. stop - 1`` of ``out``."""
    distance, nx, ny = face[0], face[1], face[2]
    for beam in range(first, stop):
        towards = nx * cos[beam] + ny * sin[beam]
        reach = np.float32(distance / towards)
        if towards > 0.0 and reach < out[beam]:
            out[beam] = reach


@kernel
def cast_rays_kernel(rows, out, pose, boxes, num_boxes, cos, sin, max_range):
    """Scan the first ``num_boxes[n]`` rows of ``boxes`` of each world n; NaN rows are absent."""
    for world in range(rows[0], rows[1]):
        row, faces = out[world], np.empty((2, 5))
        row[:] = max_range
        x, y, yaw = pose[world, 0], pose[world, 1], pose[world, 2]
        cos_yaw, sin_yaw = math.cos(yaw), math.sin(yaw)
        for box in range(num_boxes[world]):
            cx, cy, hx, hy, turn = boxes[world, box]
            if math.isnan(cx + cy + hx + hy + turn):
                continue
            cos_box, sin_box = math.cos(turn), math.sin(turn)
            cast_box(
                row, cos, sin, faces, max_range, x, y, cos_yaw, sin_yaw,
                cx, cy, hx, hy, cos_box, sin_box,
            )  # fmt: skip
