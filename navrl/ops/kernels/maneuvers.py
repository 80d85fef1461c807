"""Hybrid A* among pedestrians with known trajectories, for a base with limits.

A node is the pose and the velocity after a whole number of steps. Velocities are those of a grid of
V, and each has A maneuvers that end at a velocity of the grid; positions and headings are
continuous. Of all nodes with the same cell, sector of headings, velocity and step only the first is
expanded. The other arrays are those of :mod:`navrl.ops.kernels.space_time`.

=========== ================ ============================================================
following   [V, A]           velocity after the maneuver; -1 for no maneuver
offsets     [V, A, U, 3]     displacement (x, y, yaw) after each substep, heading 0
rest        number           index of the velocity zero, at the start
plan        [S, T]           velocity times A plus maneuver of each step
=========== ================ ============================================================
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from navrl.ops.kernels.compiler import kernel, scalar
from navrl.ops.kernels.space_time import (
    EXHAUSTED,
    FOUND,
    NODE_LIMIT,
    grown,
    is_free,
    is_too_late,
)


@scalar
def _longest_step(offsets: np.ndarray) -> float:
    """Return the longest displacement of the maneuvers [V, A, U, 3], m."""
    longest = 0.0
    for velocity in range(offsets.shape[0]):
        for maneuver in range(offsets.shape[1]):
            along, across, _ = offsets[velocity, maneuver, offsets.shape[2] - 1]
            longest = max(longest, math.hypot(along, across))
    return longest


@scalar
def is_new(seen: np.ndarray, key: int) -> bool:
    """Store a key >= 0 in an open hash table [2^K] of -1; return whether it was not in it."""
    slot = (key * 0x9E3779B97F4A7C1) & (seen.shape[0] - 1)
    while seen[slot] != -1:
        if seen[slot] == key:
            return False
        slot = (slot + 1) & (seen.shape[0] - 1)
    seen[slot] = key
    return True


@scalar
def search_maneuvers(
    start: np.ndarray, goal: np.ndarray, walls: np.ndarray, num_walls: int, people: np.ndarray,
    origin: np.ndarray, clearance: np.ndarray, steps_to_go: np.ndarray, following: np.ndarray,
    offsets: np.ndarray, rest: int, sectors: int, reach: float, goal_radius: float, cell: float,
    heuristic_weight: float, max_steps: int, max_nodes: int, plan: np.ndarray,
) -> tuple[int, int, int]:  # fmt: skip
    """Search a trajectory, write its maneuvers to ``plan``, return (code, steps, nodes)."""
    substeps, count_x, count_y = offsets.shape[2], clearance.shape[0], clearance.shape[1]
    slack = (goal_radius + 1.5 * cell) / _longest_step(offsets)
    size = 1024
    while size < 2 * max_nodes:
        size *= 2
    seen = np.full(size, -1, np.int64)
    place = np.empty((1024, 3))
    link = np.empty((1024, 4), np.int64)  # parent, maneuver in the plan, velocity, step
    place[0], link[0] = start, 0
    link[0, 0], link[0, 2] = -1, rest
    count = 1
    queue = [(0.0, 0)]
    while queue:
        _, node = heapq.heappop(queue)
        x, y, yaw = place[node]
        velocity, step = link[node, 2], link[node, 3]
        gap_x, gap_y = x - goal[0], y - goal[1]
        if gap_x * gap_x + gap_y * gap_y <= goal_radius * goal_radius and step > 0:
            while link[node, 0] >= 0:
                plan[link[node, 3] - 1] = link[node, 1]
                node = link[node, 0]
            return FOUND, step, count
        if step == max_steps:
            continue
        cos, sin = math.cos(yaw), math.sin(yaw)
        for maneuver in range(following.shape[1]):
            after = following[velocity, maneuver]
            if after < 0:
                continue
            along, across, turned = offsets[velocity, maneuver, substeps - 1]
            x_end = x + cos * along - sin * across
            y_end = y + sin * along + cos * across
            i, j = int((x_end - origin[0]) // cell), int((y_end - origin[1]) // cell)
            if i < 0 or j < 0 or i >= count_x or j >= count_y:
                continue
            left = steps_to_go[i, j]
            if is_too_late(step + 1, left, slack, max_steps):
                continue
            free = True
            for sub in range(substeps):
                along, across, _ = offsets[velocity, maneuver, sub]
                free = is_free(
                    x + cos * along - sin * across, y + sin * along + cos * across,
                    reach, cell, origin, clearance, walls, num_walls,
                    people[step * substeps + sub + 1],
                )  # fmt: skip
                if not free:
                    break
            if not free:
                continue
            if count == max_nodes:
                return NODE_LIMIT, 0, count
            sector = int((yaw + turned) * sectors / (2.0 * math.pi) // 1.0) % sectors
            key = (((step + 1) * count_x + i) * count_y + j) * sectors + sector
            if not is_new(seen, key * following.shape[0] + after):
                continue
            if count == place.shape[0]:
                place, link = grown(place), grown(link)
            place[count, 0], place[count, 1], place[count, 2] = x_end, y_end, yaw + turned
            link[count, 0] = node
            link[count, 1] = velocity * following.shape[1] + maneuver
            link[count, 2], link[count, 3] = after, step + 1
            heapq.heappush(queue, (step + 1 + heuristic_weight * left, count))
            count += 1
    return EXHAUSTED, 0, count


@kernel
def maneuver_kernel(
    rows: tuple[int, int], start: np.ndarray, goal: np.ndarray, walls: np.ndarray,
    num_walls: np.ndarray, people: np.ndarray, origin: np.ndarray, clearance: np.ndarray,
    steps_to_go: np.ndarray, following: np.ndarray, offsets: np.ndarray, rest: int,
    sectors: int, reach: float, goal_radius: float, cell: float, heuristic_weight: float,
    max_nodes: int, plan: np.ndarray, code: np.ndarray, steps: np.ndarray, nodes: np.ndarray,
) -> None:  # fmt: skip
    """Solve every query; write plan [S, T], code, steps and nodes [S]."""
    for s in range(rows[0], rows[1]):
        code[s], steps[s], nodes[s] = search_maneuvers(
            start[s], goal[s], walls[s], num_walls[s], people[s], origin[s], clearance[s],
            steps_to_go[s], following, offsets, rest, sectors, reach, goal_radius, cell,
            heuristic_weight, plan.shape[1], max_nodes, plan[s],
        )  # fmt: skip
