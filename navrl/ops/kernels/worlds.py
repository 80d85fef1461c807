"""Thousands of small worlds: one step of all of them, and one scan of all of them.

Arrays, one row a world (N worlds, W walls, K pedestrians, R route points):

========== =========== =============================================================
pose       [N, 3]      x, y, yaw of the robot
velocity   [N, 2]      v, w driven in the last substep
tick       [N]         substeps since the reset
contact    [N]         code of :mod:`navrl.ops.contact`; a world with one stands still
walls      [N, W, 6]   cx, cy, hx, hy, cos, sin; the first num_walls[n] rows count
route      [N, K, R, 2] polyline each pedestrian walks back and forth
route_arc  [N, K, R]   arc length at its points, padded with the total
walk       [N, K, 4]   speed, starting arc position, hx, hy; NaN speed where absent
boxes      [N, K, 5]   where the pedestrians are now; NaN rows where absent
========== =========== =============================================================
"""

import math

import numpy as np

from navrl.ops import contact as contacts
from navrl.ops import unicycle
from navrl.ops.contact import NONE, RUN_INTO, STATIC
from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.rays import cast_box

advance_pose = scalar(unicycle.advance_pose)
approach_velocity = scalar(unicycle.approach_velocity)
nearest_point_on_box = scalar(contacts.nearest_point_on_box)
blame = scalar(contacts.blame)

_SLACK = 1e-6  # m, so that rounding never culls a box that is touched


@scalar
def place_pedestrian(box, route, arc, walk, time_s):
    """Write where a pedestrian is at a time: a triangle wave along its route's arc length."""
    speed = walk[0]
    if math.isnan(speed):
        box[:] = np.nan
        return
    length = arc[-1]
    along, forward = 0.0, True
    if length > 0.0:
        along = (walk[1] + speed * time_s) % (2.0 * length)
        forward = along <= length
        if not forward:
            along = 2.0 * length - along
    segment = 0
    while segment < arc.shape[0] - 2 and arc[segment + 1] < along:
        segment += 1
    ax, ay = route[segment]
    dx, dy = route[segment + 1, 0] - ax, route[segment + 1, 1] - ay
    span = arc[segment + 1] - arc[segment]
    share = (along - arc[segment]) / span if span > 0.0 else 0.0
    box[0], box[1] = ax + share * dx, ay + share * dy
    box[2], box[3] = walk[2], walk[3]
    box[4] = 0.0  # who stands faces along x
    if speed > 0.0 and span > 0.0:
        box[4] = math.atan2(dy, dx) if forward else math.atan2(-dy, -dx)


@scalar
def distance(dx, dy):
    return math.sqrt(dx * dx + dy * dy)  # several times faster than hypot


@scalar
def box_distance(x, y, cx, cy, hx, hy, cos, sin):
    """Return the distance of a point from a box, zero inside."""
    px, py = nearest_point_on_box(x, y, cx, cy, hx, hy, cos, sin)
    return distance(px - x, py - y)


@scalar
def touched_wall(x, y, radius, walls, near, num_near):
    """Whether the disc reaches one of the walls listed in ``near``."""
    for index in range(num_near):
        cx, cy, hx, hy, cos, sin = walls[near[index]]
        if box_distance(x, y, cx, cy, hx, hy, cos, sin) <= radius:
            return True
    return False


@scalar
def touched_pedestrian(x, y, yaw, v, radius, boxes, near, num_near):
    """Return NONE, PEDESTRIAN or RUN_INTO for the pedestrians listed in ``near``."""
    result = NONE
    for index in range(num_near):
        cx, cy, hx, hy, turn = boxes[near[index]]
        px, py = nearest_point_on_box(x, y, cx, cy, hx, hy, math.cos(turn), math.sin(turn))
        if distance(px - x, py - y) <= radius:
            verdict = blame(x, y, math.cos(yaw), math.sin(yaw), v, px, py)
            if result in (NONE, RUN_INTO):
                result = verdict
    return result


@scalar
def list_near_walls(x, y, reach, walls, num_walls, near):
    """Write the indices of walls within ``reach`` of (x, y) to ``near``; return how many."""
    count = 0
    for wall in range(num_walls):
        cx, cy, hx, hy, cos, sin = walls[wall]
        if box_distance(x, y, cx, cy, hx, hy, cos, sin) <= reach:
            near[count] = wall
            count += 1
    return count


@scalar
def list_near_pedestrians(x, y, reach, boxes, walk, duration, near):
    """Write the indices of pedestrians that may come within ``reach``; return how many."""
    count = 0
    for pedestrian in range(boxes.shape[0]):
        cx, cy, hx, hy, turn = boxes[pedestrian]
        if math.isnan(turn):
            continue
        extent = distance(hx, hy) + walk[pedestrian, 0] * duration
        if distance(cx - x, cy - y) <= reach + extent:
            near[count] = pedestrian
            count += 1
    return count


@scalar
def step_world(
    pose, velocity, tick, command, drive, timing, walls, num_walls, route, arc, walk, boxes, near
):
    """Advance one world to its next step or first contact; return (tick, contact).

    ``drive`` is (radius, wheel separation, wheel acceleration, min v, max v, max w) and ``timing``
    (substep duration, substeps).
    """
    radius, separation, acceleration, slowest, fastest, turn_limit = drive
    duration, substeps = timing
    x, y, yaw = pose
    v, w = velocity
    v_wanted = min(max(command[0], slowest), fastest)
    w_wanted = min(max(command[1], -turn_limit), turn_limit)
    step_s = duration * substeps
    reach = radius + step_s * max(abs(v), abs(v_wanted)) + _SLACK
    num_near = list_near_walls(x, y, reach, walls, num_walls, near)
    near_pedestrians = near[num_near:]
    num_pedestrians = list_near_pedestrians(x, y, reach, boxes, walk, step_s, near_pedestrians)
    result = NONE
    for _ in range(substeps):
        if acceleration == np.inf:
            v, w = v_wanted, w_wanted
        else:
            v, w = approach_velocity(v, w, v_wanted, w_wanted, separation, acceleration * duration)
        x, y, yaw = advance_pose(x, y, yaw, v, w, duration)
        tick += 1
        for index in range(num_pedestrians):
            pedestrian = near_pedestrians[index]
            place_pedestrian(
                boxes[pedestrian],
                route[pedestrian],
                arc[pedestrian],
                walk[pedestrian],
                tick * duration,
            )
        if touched_wall(x, y, radius, walls, near, num_near):
            result = STATIC
        else:
            result = touched_pedestrian(
                x, y, yaw, v, radius, boxes, near_pedestrians, num_pedestrians
            )
        if result != NONE:
            break
    pose[0], pose[1], pose[2] = x, y, yaw
    velocity[0], velocity[1] = v, w
    return tick, result


@kernel
def step_worlds_kernel(
    rows, pose, velocity, tick, contact, command, drive, timing,
    walls, num_walls, route, route_arc, walk, boxes, near,
):  # fmt: skip
    """Advance all worlds that are not in contact; ``near`` [N, W + K] is scratch."""
    for n in range(rows[0], rows[1]):
        if contact[n] == NONE:
            tick[n], contact[n] = step_world(
                pose[n], velocity[n], tick[n], command[n], drive, timing,
                walls[n], num_walls[n], route[n], route_arc[n], walk[n], boxes[n], near[n],
            )  # fmt: skip
            place_pedestrians(boxes[n], route[n], route_arc[n], walk[n], tick[n] * timing[0])


@scalar
def place_pedestrians(boxes, route, arc, walk, time_s):
    """Write where all pedestrians of a world are."""
    for pedestrian in range(boxes.shape[0]):
        place_pedestrian(
            boxes[pedestrian], route[pedestrian], arc[pedestrian], walk[pedestrian], time_s
        )


@kernel
def place_pedestrians_kernel(rows, worlds, boxes, route, route_arc, walk, tick, duration):
    """Place the pedestrians of the listed worlds at their current time."""
    for index in range(rows[0], rows[1]):
        n = worlds[index]
        place_pedestrians(boxes[n], route[n], route_arc[n], walk[n], tick[n] * duration)


@scalar
def place_scanner(pose, mount):
    """Return (x, y, cos, sin) of a lidar mounted at (x, y, yaw) on a robot."""
    cos_robot, sin_robot = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + cos_robot * mount[0] - sin_robot * mount[1]
    y = pose[1] + sin_robot * mount[0] + cos_robot * mount[1]
    return x, y, math.cos(pose[2] + mount[2]), math.sin(pose[2] + mount[2])


@kernel
def scan_worlds_kernel(
    rows, out, worlds, pose, mount, walls, num_walls, boxes, cos, sin, max_range
):
    """Scan the listed worlds from the lidar's mount (x, y, yaw) on their robots."""
    for index in range(rows[0], rows[1]):
        n, row, faces = worlds[index], out[index], np.empty((2, 5))
        row[:] = max_range
        x, y, cos_yaw, sin_yaw = place_scanner(pose[n], mount)
        for wall in range(num_walls[n]):
            cx, cy, hx, hy, cos_box, sin_box = walls[n, wall]
            cast_box(
                row, cos, sin, faces, max_range, x, y, cos_yaw, sin_yaw,
                cx, cy, hx, hy, cos_box, sin_box,
            )  # fmt: skip
        for pedestrian in range(boxes.shape[1]):
            cx, cy, hx, hy, turn = boxes[n, pedestrian]
            if not math.isnan(turn):
                cos_box, sin_box = math.cos(turn), math.sin(turn)
                cast_box(
                    row, cos, sin, faces, max_range, x, y, cos_yaw, sin_yaw,
                    cx, cy, hx, hy, cos_box, sin_box,
                )  # fmt: skip
