"""Where the pedestrians of one world are; arrays as in :mod:`navrl.ops.kernels.worlds`."""

import math

import numpy as np

from navrl.ops.kernels.compiler import scalar


@scalar
def distance(dx, dy):
    return math.sqrt(dx * dx + dy * dy)  # several times faster than hypot


@scalar
def place_pedestrian(box, route, arc, walk, leg, time_s, share):
    """Write where a pedestrian is, ``share`` of a step after its start.

    With a leg that is its share of the line; without, a triangle wave of ``time_s`` along the
    route's arc length.
    """
    speed = walk[0]
    if math.isnan(speed):
        box[:] = np.nan
        return
    if not math.isnan(leg[0]):
        box[0] = leg[0] + share * (leg[2] - leg[0])
        box[1] = leg[1] + share * (leg[3] - leg[1])
        box[2], box[3], box[4] = walk[2], walk[3], leg[4]
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
def place_pedestrians(boxes, route, arc, walk, legs, time_s, share):
    """Write where all pedestrians of a world are; see :func:`place_pedestrian`."""
    for k in range(boxes.shape[0]):
        place_pedestrian(boxes[k], route[k], arc[k], walk[k], legs[k], time_s, share)


@scalar
def list_near_pedestrians(x, y, reach, boxes, walk, legs, duration, near):
    """Write the indices of pedestrians that may come within ``reach``; return how many."""
    count = 0
    for pedestrian in range(boxes.shape[0]):
        cx, cy, hx, hy, turn = boxes[pedestrian]
        if math.isnan(turn):
            continue
        leg = legs[pedestrian]
        walked = walk[pedestrian, 0] * duration
        if not math.isnan(leg[0]):
            walked = distance(leg[2] - leg[0], leg[3] - leg[1])
        if distance(cx - x, cy - y) <= reach + distance(hx, hy) + walked:
            near[count] = pedestrian
            count += 1
    return count
