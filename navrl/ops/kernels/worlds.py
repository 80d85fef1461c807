"""Batched simulation kernels: step all worlds and scan all worlds.

Arrays, one row per world (N worlds, W walls, K pedestrians, R route points):

========== =========== =============================================================
pose       [N, 3]      x, y, yaw of the robot
velocity   [N, 2]      v, w in the last substep
tick       [N]         substeps since the reset
contact    [N]         code of :mod:`navrl.ops.contact`; a world in contact is stationary
walls      [N, W, 6]   cx, cy, hx, hy, cos, sin; the first num_walls[n] rows are valid
route      [N, K, R, 2] polyline on which each pedestrian walks back and forth
route_arc  [N, K, R]   arc length at its points, padded with the total length
walk       [N, K, 4]   speed, initial arc length, hx, hy; NaN speed where absent
legs       [N, K, 5]   x, y at the start and end of the step, yaw; NaN rows follow their
                       route, as do all pedestrians if the shape is [N, 0, 5]
boxes      [N, K, 5]   current boxes of the pedestrians; NaN rows where absent
command    [N, T, 2]   command of each substep; T = 1: the same in all of them
track      [N, S, 5]   x, y, yaw, direction and speed of travel after each substep, or unused
past_pose  [N, L, 3]   ring of the poses after the last substeps; L = 0 if no scan is delayed
past_boxes [N, L, K, 5] boxes of the pedestrians at the same times
present    [N]         entry of the ring at the start of the step
scan_age   [N]         substeps from the last beam of a scan to the end of a step, without jitter
sweep      [N]         substeps from the first to the last beam of a scan
========== =========== =============================================================
"""

from __future__ import annotations

import math

import numpy as np

from navrl.ops import contact as contacts
from navrl.ops import unicycle
from navrl.ops.beams import first_beam
from navrl.ops.contact import HIT_BY_PEDESTRIAN, NONE, STATIC
from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.pedestrians import (
    distance,
    list_near_pedestrians,
    place_pedestrian,
    place_pedestrians,
)
from navrl.ops.kernels.rays import cast_box

advance_pose = scalar(unicycle.advance_pose)
approach_velocity = scalar(unicycle.approach_velocity)
nearest_point_on_box = scalar(contacts.nearest_point_on_box)
classify_contact = scalar(contacts.classify_contact)
first_beam = scalar(first_beam)

_SLACK = 1e-6  # m; margin so that rounding never culls a box in contact


@scalar
def is_seen(substep: int, timing: tuple[float, int, int], scan_age: int, sweep: int) -> bool:
    """Return whether a scan at the end of this or a later step may see a substep 1 .. S."""
    before_last_beam = -(substep + scan_age) % timing[1]
    return before_last_beam <= sweep + timing[2]


@scalar
def remember(
    past_pose: np.ndarray, past_boxes: np.ndarray, present: int, first: int, last: int,
    pose: tuple[float, float, float] | np.ndarray, boxes: np.ndarray,
) -> None:  # fmt: skip
    """Store pose and boxes as the entries of the substeps ``first .. last`` of a step.

    ``present`` is the entry at the start of the step.
    """
    for substep in range(first, last + 1):
        entry = (present + substep) % past_pose.shape[0]
        for index in range(3):
            past_pose[entry, index] = pose[index]
        for k in range(boxes.shape[0]):
            for index in range(5):
                past_boxes[entry, k, index] = boxes[k, index]


@scalar
def box_distance(x, y, cx, cy, hx, hy, cos, sin):
    """Return the distance from a point to a box, zero inside."""
    px, py = nearest_point_on_box(x, y, cx, cy, hx, hy, cos, sin)
    return distance(px - x, py - y)


@scalar
def touched_wall(x, y, radius, walls, near, num_near):
    """Return whether the disc touches one of the walls listed in ``near``."""
    for index in range(num_near):
        cx, cy, hx, hy, cos, sin = walls[near[index]]
        if box_distance(x, y, cx, cy, hx, hy, cos, sin) <= radius:
            return True
    return False


@scalar
def touched_pedestrian(x, y, heading, speed, radius, boxes, near, num_near):
    """Return NONE, PEDESTRIAN or HIT_BY_PEDESTRIAN for the pedestrians listed in ``near``.

    The disc at (x, y) travels in direction ``heading``, world, at ``speed``.
    """
    result = NONE
    for index in range(num_near):
        cx, cy, hx, hy, turn = boxes[near[index]]
        px, py = nearest_point_on_box(x, y, cx, cy, hx, hy, math.cos(turn), math.sin(turn))
        if distance(px - x, py - y) <= radius:
            code = classify_contact(x, y, math.cos(heading), math.sin(heading), speed, px, py)
            if result in (NONE, HIT_BY_PEDESTRIAN):
                result = code
    return result


@scalar
def list_near_walls(x, y, reach, walls, num_walls, near):
    """Write the indices of walls within ``reach`` of (x, y) to ``near``; return their number."""
    count = 0
    for wall in range(num_walls):
        cx, cy, hx, hy, cos, sin = walls[wall]
        if box_distance(x, y, cx, cy, hx, hy, cos, sin) <= reach:
            near[count] = wall
            count += 1
    return count


@scalar
def max_displacement(track):
    """Return the largest distance of the points of a track from its first point, m."""
    largest = 0.0
    for index in range(1, track.shape[0]):
        largest = max(
            largest, distance(track[index, 0] - track[0, 0], track[index, 1] - track[0, 1])
        )
    return largest


@scalar
def max_reach(pose, velocity, command, track, drive, timing):
    """Return an upper bound of the distance of the hull from the pose within a step, m."""
    radius, is_tracked, _, _, slowest, fastest, _ = drive
    if is_tracked:
        first = distance(track[0, 0] - pose[0], track[0, 1] - pose[1])
        return radius + first + max_displacement(track) + _SLACK
    target_speed = 0.0
    for index in range(command.shape[0]):
        target_speed = max(target_speed, abs(limited(command[index, 0], slowest, fastest)))
    return radius + timing[0] * timing[1] * max(abs(velocity[0]), target_speed) + _SLACK


@scalar
def limited(value, low, high):
    return min(max(value, low), high)


@scalar
def drive_substep(x, y, yaw, v, w, command, drive, duration):
    """Return pose and velocity of a differential drive after a substep with one command."""
    _, _, separation, acceleration, slowest, fastest, turn_limit = drive
    v_wanted = limited(command[0], slowest, fastest)
    w_wanted = limited(command[1], -turn_limit, turn_limit)
    if acceleration == np.inf:
        v, w = v_wanted, w_wanted
    else:
        v, w = approach_velocity(v, w, v_wanted, w_wanted, separation, acceleration * duration)
    x, y, yaw = advance_pose(x, y, yaw, v, w, duration)
    return x, y, yaw, v, w


@scalar
def step_world(
    pose, velocity, tick, command, track, drive, timing, walls, num_walls,
    route, arc, walk, legs, boxes, near, past_pose, past_boxes, present, scan_age, sweep,
):  # fmt: skip
    """Advance one world by a step or to its first contact; return (tick, contact).

    ``drive`` is (radius, whether ``track`` holds the motion, wheel separation, wheel acceleration,
    min v, max v, max w); ``timing`` is (substep duration, number of substeps, largest jitter of a
    scan's age in substeps).
    """
    (radius, is_tracked, _, _, _, _, _), (duration, substeps, _) = drive, timing
    is_remembered = past_pose.shape[0] > 0
    x, y, yaw = pose
    v, w = velocity[0], velocity[1]
    reach = max_reach(pose, velocity, command, track, drive, timing)
    num_near = list_near_walls(x, y, reach, walls, num_walls, near)
    nearby = near[num_near:]
    num_nearby = list_near_pedestrians(x, y, reach, boxes, walk, legs, duration * substeps, nearby)
    result, driven = NONE, substeps
    for index in range(substeps):
        if is_tracked:
            x, y, yaw, heading, speed = track[index]
        else:
            now = command[min(index, command.shape[0] - 1)]
            x, y, yaw, v, w = drive_substep(x, y, yaw, v, w, now, drive, duration)
            heading, speed = yaw, v
        tick += 1
        for number in range(num_nearby):
            place_pedestrian(
                nearby[number],
                boxes,
                route,
                arc,
                walk,
                legs,
                tick * duration,
                (index + 1) / substeps,
            )
        if touched_wall(x, y, radius, walls, near, num_near):
            result = STATIC
        else:
            result = touched_pedestrian(x, y, heading, speed, radius, boxes, nearby, num_nearby)
        if is_remembered and is_seen(index + 1, timing, scan_age, sweep):
            share = (index + 1) / substeps
            place_pedestrians(boxes, route, arc, walk, legs, tick * duration, share)
            remember(past_pose, past_boxes, present, index + 1, index + 1, (x, y, yaw), boxes)
        if result != NONE:
            driven = index + 1
            break
    place_pedestrians(boxes, route, arc, walk, legs, tick * duration, driven / substeps)
    pose[0], pose[1], pose[2] = x, y, yaw
    if is_remembered:  # a world is stationary after a contact
        remember(past_pose, past_boxes, present, driven + 1, substeps, pose, boxes)
    if not is_tracked:
        velocity[0], velocity[1] = v, w
    return tick, result


@kernel
def step_worlds_kernel(
    rows, pose, velocity, tick, contact, command, track, drive, timing, walls, num_walls,
    route, route_arc, walk, legs, boxes, near, past_pose, past_boxes, present, scan_age, sweep,
):  # fmt: skip
    """Advance all worlds that are not in contact; ``near`` [N, W + K] is scratch."""
    for n in range(rows[0], rows[1]):
        if contact[n] == NONE:
            tick[n], contact[n] = step_world(
                pose[n], velocity[n], tick[n], command[n], track[n], drive, timing,
                walls[n], num_walls[n], route[n], route_arc[n], walk[n], legs[n], boxes[n], near[n],
                past_pose[n], past_boxes[n], present[n], scan_age[n], sweep[n],
            )  # fmt: skip


@kernel
def place_pedestrians_kernel(rows, worlds, boxes, route, route_arc, walk, legs, tick, duration):
    """Place the pedestrians of the listed worlds at their current time."""
    for index in range(rows[0], rows[1]):
        n = worlds[index]
        place_pedestrians(
            boxes[n], route[n], route_arc[n], walk[n], legs[n], tick[n] * duration, 0.0
        )


@scalar
def place_scanner(pose, mount):
    """Return (x, y, cos, sin) of a lidar mounted at (x, y, yaw) on a robot."""
    cos_robot, sin_robot = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + cos_robot * mount[0] - sin_robot * mount[1]
    y = pose[1] + sin_robot * mount[0] + cos_robot * mount[1]
    return x, y, math.cos(pose[2] + mount[2]), math.sin(pose[2] + mount[2])


@kernel
def scan_worlds_kernel(
    rows, out, worlds, pose, mount, walls, num_walls, boxes, newest, sweep,
    cos, sin, grid, max_range,
):  # fmt: skip
    """Scan the listed worlds from the lidar's mount (x, y, yaw) on their robots.

    ``pose`` [N, L, 3] and ``boxes`` [N, L, K, 5] are rings of L substeps. The last beam sees entry
    ``newest`` [N], the first beam the entry ``sweep`` [N] substeps before it.
    """
    for index in range(rows[0], rows[1]):
        n, row, faces = worlds[index], out[index], np.empty((2, 6))
        num_parts, length = sweep[n] + 1, pose.shape[1]
        row[:] = max_range
        for part in range(num_parts):
            begin = first_beam(part, num_parts, row.shape[0])
            end = first_beam(part + 1, num_parts, row.shape[0])
            entry = (newest[n] - sweep[n] + part + length) % length
            x, y, cos_yaw, sin_yaw = place_scanner(pose[n, entry], mount)
            for wall in range(num_walls[n]):
                cx, cy, hx, hy, cos_box, sin_box = walls[n, wall]
                cast_box(
                    row, begin, end, cos, sin, grid, faces, max_range, x, y, cos_yaw, sin_yaw,
                    cx, cy, hx, hy, cos_box, sin_box,
                )  # fmt: skip
            for pedestrian in range(boxes.shape[2]):
                cx, cy, hx, hy, turn = boxes[n, entry, pedestrian]
                if not math.isnan(turn):
                    cos_box, sin_box = math.cos(turn), math.sin(turn)
                    cast_box(
                        row, begin, end, cos, sin, grid, faces, max_range, x, y, cos_yaw, sin_yaw,
                        cx, cy, hx, hy, cos_box, sin_box,
                    )  # fmt: skip
