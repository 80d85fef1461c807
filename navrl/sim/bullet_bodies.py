"""Shapes of PyBullet bodies: prisms of boxes and discs, and the robot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from navrl.sim.bullet_client import Client

NUM_SIDES = 90  # of the prism of a disc; its radius varies by 0.06 %
ROBOT_HEIGHT = 0.42  # m, TurtleBot 2
HULL_COLOR = (0.15, 0.15, 0.17, 1.0)
PLATE_COLOR = (0.45, 0.45, 0.50, 1.0)
LIDAR_COLOR = (0.10, 0.35, 0.75, 1.0)


def _prism(outline: list[tuple[float, float]]) -> tuple[list, list]:
    """Return vertices and triangles of a prism of height 2 over a convex outline.

    Rays intersect triangles exactly, while PyBullet's box shape uses an iteration that is three
    times slower and has errors of a few centimeters near edges.
    """
    count = len(outline)
    vertices = [[x, y, z] for z in (-1.0, 1.0) for x, y in outline]
    triangles: list[int] = []
    for first in range(count):
        second = (first + 1) % count
        triangles += [first, second, second + count, first, second + count, first + count]
    for first in range(1, count - 1):
        triangles += [0, first + 1, first]
        triangles += [count, count + first, count + first + 1]
    return vertices, triangles


def _circle(num_sides: int) -> list[tuple[float, float]]:
    """Return the corners of a regular polygon with the area of a circle of radius 1."""
    step = 2.0 * math.pi / num_sides
    radius = math.sqrt(step / math.sin(step))
    corners = (index * step for index in range(num_sides))
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in corners]


BOX = _prism([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
DISC = _prism(_circle(NUM_SIDES))


def prism_body(
    client: Client, prism: tuple[list, list], half: list[float], color: tuple[float, ...]
) -> int:
    """Create an immovable prism, ``BOX`` or ``DISC``, with half sizes (hx, hy, hz) m."""
    vertices, triangles = prism
    shape = client.createCollisionShape(
        client.GEOM_MESH,
        vertices=vertices,
        indices=triangles,
        meshScale=half,
        flags=client.GEOM_FORCE_CONCAVE_TRIMESH,
    )
    visual = client.createVisualShape(client.GEOM_BOX, halfExtents=half, rgbaColor=color)
    if prism is DISC:
        round_shape = {"radius": half[0], "length": 2.0 * half[2]}
        visual = client.createVisualShape(client.GEOM_CYLINDER, **round_shape, rgbaColor=color)
    body = client.createMultiBody(0.0, shape, visual)
    client.changeDynamics(body, -1, collisionMargin=0.0)
    return body


def robot_body(client: Client, radius: float, height: float) -> int:
    """Create the robot, a capsule whose side is exactly the disc of its hull, at the floor."""
    r = radius
    shape = client.createCollisionShape(client.GEOM_CAPSULE, radius=r, height=height)
    # base, top plate and lidar, as (radius, length, z of the center, color); body at the floor
    parts = [
        (r, 0.12, 0.06, HULL_COLOR),
        (0.25 * r, 0.28, 0.26, HULL_COLOR),
        (0.9 * r, 0.02, 0.41, PLATE_COLOR),
        (0.2 * r, 0.06, 0.45, LIDAR_COLOR),
    ]
    visual = client.createVisualShapeArray(
        shapeTypes=[client.GEOM_CYLINDER] * len(parts),
        radii=[part[0] for part in parts],
        lengths=[part[1] for part in parts],
        visualFramePositions=[[0.0, 0.0, part[2]] for part in parts],
        rgbaColors=[part[3] for part in parts],
    )
    return client.createMultiBody(1.0, shape, visual)  # not a static body, so rays ignore it


def bounds(boxes: list[list[float]]) -> tuple[float, float, float, float]:
    """Return the bounding box (cx, cy, hx, hy) of all boxes, m."""
    low, high = [], []
    for cx, cy, hx, hy, yaw in boxes:
        cos, sin = abs(math.cos(yaw)), abs(math.sin(yaw))
        wx, wy = cos * hx + sin * hy, sin * hx + cos * hy
        low.append((cx - wx, cy - wy))
        high.append((cx + wx, cy + wy))
    (x0, y0), (x1, y1) = np.min(low, axis=0).tolist(), np.max(high, axis=0).tolist()
    return 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (x1 - x0), 0.5 * (y1 - y0)
