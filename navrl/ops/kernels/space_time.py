"""Hybrid A* in position, heading and time among pedestrians with known trajectories.

A node is the pose after a whole number of steps. Headings are multiples of ``2 pi / bins`` and
positions are continuous, so the robot can follow a trajectory exactly; of all nodes with the same
cell, heading and step only the first is expanded.

Arrays, one row per query (S queries, W walls, K pedestrians, A primitives, C cells):

=========== ================ ============================================================
start       [S, 3]           x, y, yaw; headings are relative to this yaw
goal        [S, 2]           reached within ``goal_radius``
walls       [S, W, 6]        cx, cy, hx, hy, cos, sin; the first num_walls[s] rows are valid
people      [S, T+1, K, 6]   the same for pedestrians at each substep; NaN where absent
origin      [S, 2]           corner of the two maps
clearance   [S, CX, CY]      m from the center of a cell to the nearest wall; 0 outside
steps_to_go [S, CX, CY]      steps to the goal without pedestrians; inf if unreachable
primitives  [A, 2]           v and change of heading, in bins, of a step
offsets     [A, U, 2]        displacement after each of the U substeps, heading 0
=========== ================ ============================================================
"""

import heapq
import math

import numpy as np

from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.worlds import box_distance

FOUND, EXHAUSTED, NODE_LIMIT = range(3)  # result codes of a search


@scalar
def is_free(x, y, reach, cell, origin, clearance, walls, num_walls, people):
    """Return whether a disc of radius ``reach`` touches no wall and none of ``people``."""
    i, j = int((x - origin[0]) // cell), int((y - origin[1]) // cell)
    if i < 0 or j < 0 or i >= clearance.shape[0] or j >= clearance.shape[1]:
        return False
    slack = 0.7072 * cell  # largest distance of a point in a cell from its center
    if clearance[i, j] + slack <= reach:
        return False
    if clearance[i, j] - slack <= reach:
        for wall in range(num_walls):
            cx, cy, hx, hy, cos, sin = walls[wall]
            if box_distance(x, y, cx, cy, hx, hy, cos, sin) <= reach:
                return False
    for person in range(people.shape[0]):
        cx, cy, hx, hy, cos, sin = people[person]
        near = reach + hx + hy
        is_near = abs(cx - x) <= near and abs(cy - y) <= near  # False where absent
        if is_near and box_distance(x, y, cx, cy, hx, hy, cos, sin) <= reach:
            return False
    return True


@scalar
def grown(array):
    """Return a copy with twice as many rows."""
    result = np.empty((2 * array.shape[0], *array.shape[1:]), array.dtype)
    result[: array.shape[0]] = array
    return result


@scalar
def is_too_late(step: int, steps_to_go: float, slack: float, max_steps: int) -> bool:
    """Return whether the goal cannot be reached within ``max_steps`` from a node.

    ``steps_to_go`` measures paths on a grid of 8 neighbors, which are longer than the shortest by a
    factor of up to 1 / cos(22.5 degrees), from centers of cells to the middle of the goal;
    ``slack`` is the distance between those and the true ends, in steps.
    """
    return step + 0.9238 * steps_to_go - slack > max_steps


@scalar
def search(
    start, goal, walls, num_walls, people, origin, clearance, steps_to_go,
    primitives, offsets, bins, reach, goal_radius, cell, heuristic_weight, max_steps, max_nodes,
    plan,
):  # fmt: skip
    """Search a trajectory, write its primitives to ``plan``, return (code, steps, nodes)."""
    substeps = offsets.shape[1]
    longest_step = np.max(np.abs(offsets[:, substeps - 1, 0]))  # of a straight move
    slack = (goal_radius + 1.5 * cell) / longest_step
    seen = np.zeros((max_steps + 1, *clearance.shape, bins), np.bool_)
    cos = np.cos(start[2] + np.arange(bins) * (2.0 * math.pi / bins))
    sin = np.sin(start[2] + np.arange(bins) * (2.0 * math.pi / bins))
    place = np.empty((1024, 2))
    link = np.empty((1024, 4), np.int64)  # parent, primitive, heading, step
    place[0], link[0] = start[:2], 0
    link[0, 0] = -1
    count = 1
    queue = [(0.0, 0)]
    while queue:
        _, node = heapq.heappop(queue)
        x, y = place[node]
        heading, step = link[node, 2], link[node, 3]
        gap_x, gap_y = x - goal[0], y - goal[1]
        if gap_x * gap_x + gap_y * gap_y <= goal_radius * goal_radius and step > 0:
            while link[node, 0] >= 0:
                plan[link[node, 3] - 1] = link[node, 1]
                node = link[node, 0]
            return FOUND, step, count
        if step == max_steps:
            continue
        for primitive in range(primitives.shape[0]):
            along, across = offsets[primitive, substeps - 1]
            x_end = x + cos[heading] * along - sin[heading] * across
            y_end = y + sin[heading] * along + cos[heading] * across
            i, j = int((x_end - origin[0]) // cell), int((y_end - origin[1]) // cell)
            if i < 0 or j < 0 or i >= clearance.shape[0] or j >= clearance.shape[1]:
                continue
            turned = (heading + int(primitives[primitive, 1])) % bins
            left = steps_to_go[i, j]
            if is_too_late(step + 1, left, slack, max_steps) or seen[step + 1, i, j, turned]:
                continue
            free = True
            for sub in range(substeps):
                along, across = offsets[primitive, sub]
                free = is_free(
                    x + cos[heading] * along - sin[heading] * across,
                    y + sin[heading] * along + cos[heading] * across,
                    reach, cell, origin, clearance, walls, num_walls,
                    people[step * substeps + sub + 1],
                )  # fmt: skip
                if not free:
                    break
            if not free:
                continue
            if count == max_nodes:
                return NODE_LIMIT, 0, count
            if count == place.shape[0]:
                place, link = grown(place), grown(link)
            seen[step + 1, i, j, turned] = True
            place[count, 0], place[count, 1] = x_end, y_end
            link[count, 0], link[count, 1] = node, primitive
            link[count, 2], link[count, 3] = turned, step + 1
            heapq.heappush(queue, (step + 1 + heuristic_weight * left, count))
            count += 1
    return EXHAUSTED, 0, count


@kernel
def plan_kernel(
    rows, start, goal, walls, num_walls, people, origin, clearance, steps_to_go,
    primitives, offsets, bins, reach, goal_radius, cell, heuristic_weight, max_nodes, plan, code,
    steps, nodes,
):  # fmt: skip
    """Solve every query; write plan [S, T], code, steps and nodes [S]."""
    for s in range(rows[0], rows[1]):
        code[s], steps[s], nodes[s] = search(
            start[s], goal[s], walls[s], num_walls[s], people[s], origin[s], clearance[s],
            steps_to_go[s], primitives, offsets, bins, reach, goal_radius, cell, heuristic_weight,
            plan.shape[1], max_nodes, plan[s],
        )  # fmt: skip
