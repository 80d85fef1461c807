"""Pedestrian positions of one world; arrays as in :mod:`navrl.ops.kernels.worlds`."""

from __future__ import annotations

import math

import numpy as np

from navrl.ops import gait
from navrl.ops.bodies import BODY_BOX, BODY_LEGS
from navrl.ops.gait import MAX_FOOT_REACH_M
from navrl.ops.kernels.compiler import kernel, scalar

foot_offset = scalar(gait.foot_offset)
_step_length = scalar(gait.step_length)


@scalar
def distance(dx: float, dy: float) -> float:
    return math.sqrt(dx * dx + dy * dy)  # several times faster than hypot


@scalar
def foot_center(state: np.ndarray, side: int) -> tuple[float, float]:
    """Return the center of a leg of a pedestrian; as :func:`navrl.ops.gait.foot_center`."""
    ahead = foot_offset(state[5] + side, state[6])
    left = gait.HALF_STEP_WIDTH_M * (1.0 - 2.0 * side)
    cos, sin = math.cos(state[4]), math.sin(state[4])
    return state[0] + cos * ahead - sin * left, state[1] + sin * ahead + cos * left


@scalar
def follow_move(state: np.ndarray, walk: np.ndarray, move: np.ndarray, share: float) -> None:
    """Write the state of a pedestrian at the fraction ``share`` of its step."""
    state[0] = move[0] + share * (move[2] - move[0])
    state[1] = move[1] + share * (move[3] - move[1])
    state[2], state[3], state[4] = walk[2], walk[3], move[4]
    state[5], state[6] = move[5] + share * (move[6] - move[5]), move[7]


@scalar
def follow_route(
    state: np.ndarray, route: np.ndarray, arc: np.ndarray, walk: np.ndarray, time_s: float
) -> None:
    """Write the state of a pedestrian at a time: a triangle wave along its route's arc length."""
    speed = walk[0]
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
    state[0], state[1] = ax + share * dx, ay + share * dy
    state[2], state[3] = walk[2], walk[3]
    state[4] = 0.0  # a stationary pedestrian faces along x
    if speed > 0.0 and span > 0.0:
        state[4] = math.atan2(dy, dx) if forward else math.atan2(-dy, -dx)
    state[5], state[6] = 0.0, 0.0
    if speed > 0.0:
        state[6] = _step_length(speed)
        state[5] = (walk[1] + speed * time_s) / state[6]


@scalar
def follow_track(
    state: np.ndarray, route: np.ndarray, times: np.ndarray, walk: np.ndarray, gaits: np.ndarray,
    time_s: float,
) -> None:  # fmt: skip
    """Write the state of a pedestrian at a time of its track; NaN before and after it."""
    last = times.shape[0] - 1
    if not times[0] <= time_s <= times[last]:
        state[:] = np.nan
        return
    low, high = 0, last  # the segment from low to high is the first with times[high] >= time_s
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] < time_s:
            low = middle
        else:
            high = middle
    span = times[high] - times[low]
    share = (time_s - times[low]) / span if span > 0.0 else 0.0
    for axis in range(2):
        state[axis] = route[low, axis] + share * (route[high, axis] - route[low, axis])
        state[2 + axis] = walk[2 + axis]
    state[4] = gaits[low, 1]
    state[5] = gaits[low, 0] + share * (gaits[high, 0] - gaits[low, 0])
    state[6] = gaits[low, 2]


@scalar
def place_pedestrian(
    k: int, states: np.ndarray, route: np.ndarray, arc: np.ndarray, walk: np.ndarray,
    gaits: np.ndarray, moves: np.ndarray, time_s: float, share: float,
) -> None:  # fmt: skip
    """Write the state of pedestrian ``k`` at the fraction ``share`` of a step.

    ``moves`` has no rows if all pedestrians follow their routes.
    """
    if moves.shape[0] > 0 and not math.isnan(moves[k, 0]):
        follow_move(states[k], walk[k], moves[k], share)
    elif math.isnan(walk[k, 0]):
        states[k, :] = np.nan
    elif walk[k, 6] > 0.0:
        follow_track(states[k], route[k], arc[k], walk[k], gaits[k], time_s)
    else:
        follow_route(states[k], route[k], arc[k], walk[k], time_s)


@scalar
def place_pedestrians(
    states: np.ndarray, route: np.ndarray, arc: np.ndarray, walk: np.ndarray, gaits: np.ndarray,
    moves: np.ndarray, time_s: float, share: float,
) -> None:  # fmt: skip
    """Write the states of all pedestrians of a world; see :func:`place_pedestrian`."""
    for k in range(states.shape[0]):
        place_pedestrian(k, states, route, arc, walk, gaits, moves, time_s, share)


@scalar
def list_near_pedestrians(
    x: float, y: float, reach: float, states: np.ndarray, arc: np.ndarray, walk: np.ndarray,
    moves: np.ndarray, time_s: float, duration: float, near: np.ndarray,
) -> int:  # fmt: skip
    """Write the indices of pedestrians that may come within ``reach``; return their number."""
    count = 0
    for k in range(states.shape[0]):
        cx, cy, hx, hy, turn = states[k, 0], states[k, 1], states[k, 2], states[k, 3], states[k, 4]
        if math.isnan(turn):
            appears = walk[k, 6] > 0.0 and time_s <= arc[k, 0] <= time_s + duration
            if appears:  # during this step
                near[count] = k
                count += 1
            continue
        walked = walk[k, 0] * duration
        if moves.shape[0] > 0 and not math.isnan(moves[k, 0]):
            walked = distance(moves[k, 2] - moves[k, 0], moves[k, 3] - moves[k, 1])
        extent = distance(hx, hy)
        if walk[k, 4] == BODY_LEGS:
            extent = max(extent, MAX_FOOT_REACH_M)
        if distance(cx - x, cy - y) <= reach + extent + walked:
            near[count] = k
            count += 1
    return count


@scalar
def shape_of_part(shape: np.ndarray, state: np.ndarray, walk: np.ndarray, part: int) -> None:
    """Write (cx, cy, hx, hy, cos, sin) of a part of a pedestrian.

    Part 0 is the body; parts 1 and 2 are the moves. A disc has cosine and sine 0.
    """
    if part > 0:
        shape[0], shape[1] = foot_center(state, part - 1)
        shape[2], shape[3], shape[4], shape[5] = walk[5], walk[5], 0.0, 0.0
        return
    for index in range(4):
        shape[index] = state[index]
    shape[4], shape[5] = 0.0, 0.0
    if walk[4] == BODY_BOX:
        shape[4], shape[5] = math.cos(state[4]), math.sin(state[4])


@scalar
def num_parts(walk: np.ndarray) -> int:
    """Return the number of parts of a pedestrian that the hull can touch."""
    return 3 if walk[4] == BODY_LEGS else 1


@scalar
def first_seen_part(walk: np.ndarray) -> int:
    """Return the first part that a lidar sees: the legs of a pedestrian that has them."""
    return 1 if walk[4] == BODY_LEGS else 0


@kernel
def place_pedestrians_kernel(
    rows: tuple[int, int], worlds: np.ndarray, states: np.ndarray, route: np.ndarray,
    route_arc: np.ndarray, walk: np.ndarray, gaits: np.ndarray, moves: np.ndarray, tick: np.ndarray,
    duration: float,
) -> None:  # fmt: skip
    """Place the pedestrians of the listed worlds at their current time."""
    for index in range(rows[0], rows[1]):
        n = worlds[index]
        place_pedestrians(
            states[n], route[n], route_arc[n], walk[n], gaits[n], moves[n], tick[n] * duration, 0.0
        )
