"""PyBullet bodies of one world: walls, pedestrians, goal and robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

from navrl.ops.contact import NONE, PEDESTRIAN, STATIC, classify_contact
from navrl.ops.raycast import beam_directions
from navrl.sim.lidar import Lidar
from navrl.sim.robot import RobotModel

if TYPE_CHECKING:
    from navrl.sim.bullet_client import Client

WALL_HEIGHT = 1.2  # m; both heights grow if the lidar scans above them
PEDESTRIAN_HEIGHT = 1.0  # m; lower than walls, so that a ray from above hits a wall first
HEADROOM = 0.5  # m of obstacle above the scan plane
ROBOT_HEIGHT = 0.42  # m, TurtleBot 2
REACH = 1e-3  # m; the exact distance is computed for bodies nearer than this

STATIC_GROUP = 2  # PyBullet's collision group of bodies without mass, the targets of rays

# A box of half sizes 1 as triangles. Rays intersect triangles exactly, while PyBullet's box shape
# uses an iteration that is three times slower and has errors of a few centimeters near edges.
CORNERS = [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
TRIANGLES = [corner for a, b, c, d in FACES for corner in (a, b, c, a, c, d)]

WALL_COLOR = (0.66, 0.69, 0.74, 1.0)
PEDESTRIAN_COLOR = (0.86, 0.44, 0.20, 1.0)
FLOOR_COLOR = (0.95, 0.95, 0.93, 1.0)
PATH_COLOR = (0.25, 0.65, 0.35, 1.0)
HULL_COLOR = (0.15, 0.15, 0.17, 1.0)
PLATE_COLOR = (0.45, 0.45, 0.50, 1.0)
LIDAR_COLOR = (0.10, 0.35, 0.75, 1.0)


class Scene:
    """Bodies of one world on its own level of a client, at its own height.

    Bodies have no collision margin, and the robot is an upright capsule, whose side is exactly the
    disc-shaped hull, so distances are accurate to 1e-12 m. (The error of PyBullet's cylinder is
    3 um, that of its box with the default margin 0.4 mm at corners.)

    Args:
        client: PyBullet client of the bodies.
        robot: Robot model, for its radius.
        lidar: Lidar model, for its beams and mount.
        floor: Height of the floor of this level, m.
    """

    def __init__(self, client: Client, robot: RobotModel, lidar: Lidar, floor: float) -> None:
        self._client, self._floor = client, floor
        self._radius, self._lidar = robot.radius, lidar
        self._wall_height = max(WALL_HEIGHT, lidar.height + HEADROOM)
        self._pedestrian_height = self._wall_height + PEDESTRIAN_HEIGHT - WALL_HEIGHT
        self._scan_height = floor + lidar.height
        self._directions = beam_directions(*lidar.beams).numpy()
        self.forget()

    def forget(self) -> None:
        """Clear the lists of bodies after the client has removed them."""
        self.bodies: list[int] = []
        self._pedestrians: list[int] = []

    def build(self, scenario: dict[str, Tensor]) -> None:
        """Replace all bodies.

        Args:
            scenario: One row of a :class:`navrl.worlds.ScenarioBatch`, present pedestrians first.
        """
        for body in self.bodies:
            self._client.removeBody(body)
        self.forget()
        walls = scenario["boxes"][: scenario["num_boxes"]].tolist()
        for wall in walls:
            body = self._box_body(wall[2], wall[3], self._wall_height, WALL_COLOR)
            self._move(body, wall[0], wall[1], 0.5 * self._wall_height, wall[4])
        for half in scenario["ped_half"][scenario["ped_present"]].tolist():
            self._pedestrians.append(
                self._box_body(half[0], half[1], self._pedestrian_height, PEDESTRIAN_COLOR)
            )
        self._robot = self._robot_body()
        self._view = _bounds(walls or [[*scenario["goal"].tolist(), 3.0, 3.0, 0.0]])
        self._add_surroundings(scenario)

    def _box_body(self, hx: float, hy: float, height: float, color: tuple) -> int:
        client, half = self._client, [hx, hy, 0.5 * height]
        shape = client.createCollisionShape(
            client.GEOM_MESH,
            vertices=CORNERS,
            indices=TRIANGLES,
            meshScale=half,
            flags=client.GEOM_FORCE_CONCAVE_TRIMESH,
        )
        visual = client.createVisualShape(client.GEOM_BOX, halfExtents=half, rgbaColor=color)
        body = self._body(shape, visual)
        client.changeDynamics(body, -1, collisionMargin=0.0)
        return body

    def _robot_body(self) -> int:
        client, r = self._client, self._radius
        height = max(ROBOT_HEIGHT, 2.0 * self._lidar.height)
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
        return self._body(shape, visual, mass=1.0)  # not a static body, so rays ignore it

    def _add_surroundings(self, scenario: dict[str, Tensor]) -> None:
        """Add the visual-only bodies: floor and goal."""
        client, (x, y, hx, hy) = self._client, self._view
        floor = client.createVisualShape(
            client.GEOM_BOX, halfExtents=[hx, hy, 0.01], rgbaColor=FLOOR_COLOR
        )
        self._move(self._body(-1, floor), x, y, -0.01)
        goal = client.createVisualShape(
            client.GEOM_CYLINDER, radius=0.2, length=0.02, rgbaColor=PATH_COLOR
        )
        goal_x, goal_y = scenario["goal"].tolist()
        self._move(self._body(-1, goal), goal_x, goal_y, 0.01)
        self._path = scenario["path"]

    def _body(self, shape: int, visual: int, mass: float = 0.0) -> int:
        body = self._client.createMultiBody(mass, shape, visual)
        self.bodies.append(body)
        return body

    def _move(self, body: int, x: float, y: float, z: float, yaw: float = 0.0) -> None:
        orientation = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
        self._client.resetBasePositionAndOrientation(body, (x, y, self._floor + z), orientation)

    def place(self, pose: Sequence[float], boxes: list[list[float]]) -> None:
        """Move the robot to (x, y, yaw) and the pedestrians to ``boxes``."""
        x, y, yaw = pose
        self._move(self._robot, x, y, 0.0, yaw)
        middle = 0.5 * self._pedestrian_height
        for body, box in zip(self._pedestrians, boxes, strict=False):  # absent ones come last
            self._move(body, box[0], box[1], middle, box[4])

    def contact(self, pose: Sequence[float], travel: tuple[float, float]) -> int:
        """Return the contact code of the robot at (x, y, yaw).

        ``travel`` is its direction of travel, world, rad, and the speed along it, m/s.
        """
        (x, y, _), (heading, speed) = pose, travel
        reach, z = self._radius + REACH, self._scan_height
        near = self._client.getOverlappingObjects(
            (x - reach, y - reach, z), (x + reach, y + reach, z)
        )
        inside = None  # the body that contains (x, y); computed only if there are bodies nearby
        result = NONE
        for body in {body for body, _ in near or ()} - {self._robot}:
            inside = self._surrounding_body(x, y) if inside is None else inside
            point = (x, y) if body == inside else self._touched_point(body)
            if point is None:
                continue
            if body not in self._pedestrians:
                return STATIC
            if result != PEDESTRIAN:
                result = classify_contact(x, y, math.cos(heading), math.sin(heading), speed, *point)
        return result

    def _touched_point(self, body: int) -> tuple[float, float] | None:
        """Return the point (x, y) of deepest penetration into the body, None without contact."""
        points = self._client.getClosestPoints(self._robot, body, REACH)
        deepest = min(points, key=lambda point: point[8], default=None)
        return None if deepest is None or deepest[8] > 0.0 else deepest[6][:2]

    def _surrounding_body(self, x: float, y: float) -> int:
        """Return the body that contains (x, y), -1 if none, by a ray from above."""
        top = self._floor + self._wall_height + HEADROOM
        hit = self._client.rayTest(
            (x, y, top), (x, y, self._scan_height), collisionFilterMask=STATIC_GROUP
        )
        return hit[0][0]

    def scan(self, pose: Sequence[float], begin: int = 0, end: int | None = None) -> np.ndarray:
        """Return ranges of the lidar for the robot at (x, y, yaw).

        Returns:
            [end - begin] float32 m, of the beams ``begin .. end - 1``; of all beams by default.
        """
        (x, y, yaw), (along, across, turn) = pose, self._lidar.mount
        x += math.cos(yaw) * along - math.sin(yaw) * across
        y += math.sin(yaw) * along + math.cos(yaw) * across
        beam_cos, beam_sin = self._directions[:, begin:end]
        if self._surrounding_body(x, y) >= 0:
            return np.zeros(len(beam_cos), dtype=np.float32)
        cos, sin = math.cos(yaw + turn), math.sin(yaw + turn)
        reach = self._lidar.max_range
        ends = np.empty((len(beam_cos), 3))
        ends[:, 0] = x + reach * (cos * beam_cos - sin * beam_sin)
        ends[:, 1] = y + reach * (sin * beam_cos + cos * beam_sin)
        ends[:, 2] = self._scan_height
        start, max_rays = (
            (x, y, self._scan_height),
            self._client.MAX_RAY_INTERSECTION_BATCH_SIZE // 2,
        )
        fractions = []  # (half of the limit, because a full batch returns one ray less)
        for first in range(0, len(ends), max_rays):
            chunk = ends[first : first + max_rays].tolist()
            hits = self._client.rayTestBatch(
                [start] * len(chunk), chunk, numThreads=1, collisionFilterMask=STATIC_GROUP
            )
            fractions += [hit[2] for hit in hits]  # exactly 1 without a hit
        return (np.array(fractions) * reach).astype(np.float32)

    def show(self) -> None:
        """Point the camera of the window at this scene and draw the path."""
        client, (x, y, hx, hy) = self._client, self._view
        client.resetDebugVisualizerCamera(1.2 * max(hx, hy), 0.0, -75.0, (x, y, self._floor))
        client.removeAllUserDebugItems()
        points = [(px, py, self._floor + 0.02) for px, py in self._path.tolist()]
        for begin, end in zip(points[:-1:3], points[3::3], strict=False):
            client.addUserDebugLine(begin, end, PATH_COLOR[:3], 2.0)

    def render(self, width: int, height: int) -> np.ndarray:
        """Return a picture [height, width, 3] uint8 of the scene from above."""
        client, (x, y, hx, hy) = self._client, self._view
        above = 1.25 * max(hy, hx * height / width) / math.tan(math.radians(20.0))
        eye = (x, y - 0.25 * above, self._floor + above)
        view = client.computeViewMatrix(eye, (x, y, self._floor), (0.0, 1.0, 0.0))
        lens = client.computeProjectionMatrixFOV(40.0, width / height, 0.1, 2.0 * above)
        picture = client.getCameraImage(
            width, height, view, lens, shadow=0, renderer=client.ER_TINY_RENDERER
        )
        return np.reshape(picture[2], (height, width, 4))[..., :3].astype(np.uint8)


def _bounds(boxes: list[list[float]]) -> tuple[float, float, float, float]:
    """Return the bounding box (cx, cy, hx, hy) of all boxes, m."""
    low, high = [], []
    for cx, cy, hx, hy, yaw in boxes:
        cos, sin = abs(math.cos(yaw)), abs(math.sin(yaw))
        wx, wy = cos * hx + sin * hy, sin * hx + cos * hy
        low.append((cx - wx, cy - wy))
        high.append((cx + wx, cy + wy))
    (x0, y0), (x1, y1) = np.min(low, axis=0).tolist(), np.max(high, axis=0).tolist()
    return 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (x1 - x0), 0.5 * (y1 - y0)
