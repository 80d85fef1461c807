"""Batched simulation kernel: step all worlds.

Arrays, one row per world (N worlds, W walls, K pedestrians, R route points):

========== =========== =============================================================
pose       [N, 3]      x, y, yaw of the robot
velocity   [N, 2]      v, w in the last substep
tick       [N]         substeps since the reset
contact    [N]         code of :mod:`navrl.ops.contact`; a world in contact is stationary
walls      [N, W, 8]   cx, cy, hx, hy, cos, sin, seen by the lidar, touched by the hull (0 or
                       1); cos and sin of a disc are 0, hx is its radius; the first
                       num_walls[n] rows are valid; cells of :mod:`navrl.ops.kernels.cells`
route      [N, K, R, 2] polyline on which each pedestrian walks, back and forth or as a track
route_arc  [N, K, R]   arc length at its points, padded with the total length; of a track the
                       time
walk       [N, K, 7]   (largest) speed, initial arc length, hx, hy, code of the body, radius of a
                       leg, whether the route is a track; NaN speed where absent
gaits      [N, K, G, 3] phase, yaw and step length at the points of tracks; G = 0 without tracks
moves      [N, K, 8]   x, y at the start and end of the step, yaw, phase at the start and end,
                       step length; NaN rows follow their route, as do all pedestrians if the
                       shape is [N, 0, 8]
boxes      [N, K, 7]   current states of the pedestrians: box, phase of the gait, step length;
                       NaN rows where absent
command    [N, T, 2]   command of each substep; T = 1: the same in all of them
track      [N, S, 5]   x, y, yaw, direction and speed of travel after each substep, or unused
past_pose  [N, L, 3]   ring of the poses after the last substeps; L = 0 if no scan is delayed
past_boxes [N, L, K, 7] states of the pedestrians at the same times
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
from navrl.ops.contact import HIT_BY_PEDESTRIAN, NONE, STATIC
from navrl.ops.kernels.cells import list_near_walls
from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.pedestrians import (
    distance,
    list_near_pedestrians,
    num_parts,
    place_pedestrian,
    place_pedestrians,
    shape_of_part,
)

advance_pose = scalar(unicycle.advance_pose)
approach_velocity = scalar(unicycle.approach_velocity)
nearest_point_on_box = scalar(contacts.nearest_point_on_box)
classify_contact = scalar(contacts.classify_contact)
nearest_point_on_disc = scalar(contacts.nearest_point_on_disc)

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
            for index in range(boxes.shape[1]):
                past_boxes[entry, k, index] = boxes[k, index]


@scalar
def nearest_point(
    x: float, y: float, cx: float, cy: float, hx: float, hy: float, cos: float, sin: float
) -> tuple[float, float]:
    """Return the point of a box or disc that is nearest to (x, y); this point itself if inside."""
    if cos == 0.0 and sin == 0.0:
        return nearest_point_on_disc(x, y, cx, cy, hx)
    return nearest_point_on_box(x, y, cx, cy, hx, hy, cos, sin)


@scalar
def box_distance(x, y, cx, cy, hx, hy, cos, sin):
    """Return the distance from a point to a box or disc, zero inside."""
    px, py = nearest_point(x, y, cx, cy, hx, hy, cos, sin)
    return distance(px - x, py - y)


@scalar
def touched_wall(x, y, radius, walls, near, num_near):
    """Return whether the disc touches one of the walls listed in ``near``."""
    for index in range(num_near):
        cx, cy, hx, hy, cos, sin, _, _ = walls[near[index]]
        if box_distance(x, y, cx, cy, hx, hy, cos, sin) <= radius:
            return True
    return False


@scalar
def touched_pedestrian(
    x: float, y: float, heading: float, speed: float, radius: float, states: np.ndarray,
    walk: np.ndarray, near: np.ndarray, num_near: int, shape: np.ndarray,
) -> int:  # fmt: skip
    """Return NONE, PEDESTRIAN or HIT_BY_PEDESTRIAN for the pedestrians listed in ``near``.

    The disc at (x, y) travels in direction ``heading``, world, at ``speed``; ``shape`` [6] is
    scratch.
    """
    result = NONE
    for index in range(num_near):
        state, kind = states[near[index]], walk[near[index]]
        if math.isnan(state[4]):
            continue
        for part in range(num_parts(kind)):
            shape_of_part(shape, state, kind, part)
            px, py = nearest_point(x, y, shape[0], shape[1], shape[2], shape[3], shape[4], shape[5])
            if distance(px - x, py - y) <= radius:
                code = classify_contact(x, y, math.cos(heading), math.sin(heading), speed, px, py)
                if result in (NONE, HIT_BY_PEDESTRIAN):
                    result = code
    return result


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
    cell_start, cell_info, route, arc, walk, gaits, moves, boxes, near,
    shape, past_pose, past_boxes, present, scan_age, sweep,
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
    num_near = list_near_walls(x, y, reach, walls, num_walls, cell_start, cell_info, near)
    nearby = near[num_near:]
    num_nearby = list_near_pedestrians(
        x, y, reach, boxes, arc, walk, moves, tick * duration, duration * substeps, nearby
    )
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
                gaits,
                moves,
                tick * duration,
                (index + 1) / substeps,
            )
        if touched_wall(x, y, radius, walls, near, num_near):
            result = STATIC
        else:
            result = touched_pedestrian(
                x, y, heading, speed, radius, boxes, walk, nearby, num_nearby, shape
            )
        if is_remembered and is_seen(index + 1, timing, scan_age, sweep):
            share = (index + 1) / substeps
            place_pedestrians(boxes, route, arc, walk, gaits, moves, tick * duration, share)
            remember(past_pose, past_boxes, present, index + 1, index + 1, (x, y, yaw), boxes)
        if result != NONE:
            driven = index + 1
            break
    place_pedestrians(boxes, route, arc, walk, gaits, moves, tick * duration, driven / substeps)
    pose[0], pose[1], pose[2] = x, y, yaw
    if is_remembered:  # a world is stationary after a contact
        remember(past_pose, past_boxes, present, driven + 1, substeps, pose, boxes)
    if not is_tracked:
        velocity[0], velocity[1] = v, w
    return tick, result


@kernel
def step_worlds_kernel(
    rows, pose, velocity, tick, contact, command, track, drive, timing, walls, num_walls,
    cell_start, cell_info, route, route_arc, walk, gaits, moves, boxes, near,
    past_pose, past_boxes, present, scan_age, sweep,
):  # fmt: skip
    """Advance all worlds that are not in contact; ``near`` [N, W + K] is scratch."""
    shape = np.empty(6)
    for n in range(rows[0], rows[1]):
        if contact[n] == NONE:
            tick[n], contact[n] = step_world(
                pose[n], velocity[n], tick[n], command[n], track[n], drive, timing,
                walls[n], num_walls[n], cell_start[n], cell_info[n], route[n],
                route_arc[n], walk[n], gaits[n], moves[n], boxes[n], near[n], shape,
                past_pose[n], past_boxes[n], present[n], scan_age[n], sweep[n],
            )  # fmt: skip
