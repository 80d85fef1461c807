"""Pedestrian positions of one world; arrays as in :mod:`navrl.ops.kernels.worlds`."""

import math

import numpy as np

from navrl.ops.kernels.compiler import scalar


@scalar
def distance(dx, dy):
    return math.sqrt(dx * dx + dy * dy)  # several times faster than hypot


@scalar
def follow_leg(box, walk, leg, share):
    """Write the box of a pedestrian at the fraction ``share`` of its leg."""
    box[0] = leg[0] + share * (leg[2] - leg[0])
    box[1] = leg[1] + share * (leg[3] - leg[1])
    box[2], box[3], box[4] = walk[2], walk[3], leg[4]


@scalar
def follow_route(box, route, arc, walk, time_s):
    """Write the box of a pedestrian at a time: a triangle wave along its route's arc length."""
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
    box[4] = 0.0  # a stationary pedestrian faces along x
    if speed > 0.0 and span > 0.0:
        box[4] = math.atan2(dy, dx) if forward else math.atan2(-dy, -dx)


@scalar
def place_pedestrian(k, boxes, route, arc, walk, legs, time_s, share):
    """Write the box of pedestrian ``k`` at the fraction ``share`` of a step.

    ``legs`` has no rows if all pedestrians follow their routes.
    """
    if legs.shape[0] > 0 and not math.isnan(legs[k, 0]):
        follow_leg(boxes[k], walk[k], legs[k], share)
    else:
        follow_route(boxes[k], route[k], arc[k], walk[k], time_s)


@scalar
def place_pedestrians(boxes, route, arc, walk, legs, time_s, share):
    """Write the boxes of all pedestrians of a world; see :func:`place_pedestrian`."""
    for k in range(boxes.shape[0]):
        place_pedestrian(k, boxes, route, arc, walk, legs, time_s, share)


@scalar
def list_near_pedestrians(x, y, reach, boxes, walk, legs, duration, near):
    """Write the indices of pedestrians that may come within ``reach``; return their number."""
    count = 0
    for k in range(boxes.shape[0]):
        cx, cy, hx, hy, turn = boxes[k]
        if math.isnan(turn):
            continue
        walked = walk[k, 0] * duration
        if legs.shape[0] > 0 and not math.isnan(legs[k, 0]):
            walked = distance(legs[k, 2] - legs[k, 0], legs[k, 3] - legs[k, 1])
        if distance(cx - x, cy - y) <= reach + distance(hx, hy) + walked:
            near[count] = k
            count += 1
    return count
