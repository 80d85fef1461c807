"""PyBullet bodies of one world: walls, pedestrians, goal and robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from torch import Tensor

from navrl.ops.bodies import BODY_BOX, BODY_LEGS
from navrl.ops.contact import NONE, PEDESTRIAN, STATIC, classify_contact
from navrl.ops.gait import foot_center
from navrl.ops.raycast import beam_directions
from navrl.sim.bullet_bodies import BOX, DISC, ROBOT_HEIGHT, bounds, prism_body, robot_body
from navrl.sim.lidar import Lidar
from navrl.sim.obstacle_rows import visibility
from navrl.sim.robot import RobotModel
from navrl.worlds import ScenarioBatch

if TYPE_CHECKING:
    from navrl.sim.bullet_client import Client

WALL_HEIGHT = 1.2  # m; both heights grow if the lidar scans above them
PEDESTRIAN_HEIGHT = 1.0  # m; lower than walls, so that a ray from above hits a wall first
HEADROOM = 0.5  # m of obstacle above the scan plane
REACH = 1e-3  # m; the exact distance is computed for bodies nearer than this
AWAY_M = 1e5  # m, position of absent pedestrians
STATIC_GROUP = 2  # PyBullet's collision group of bodies without mass, the targets of rays
SEEN_GROUP, TOUCHED_GROUP = 128, 64  # of bodies that only the lidar or only the hull meets

WALL_COLOR = (0.66, 0.69, 0.74, 1.0)
PEDESTRIAN_COLOR = (0.86, 0.44, 0.20, 1.0)
FLOOR_COLOR = (0.95, 0.95, 0.93, 1.0)
PATH_COLOR = (0.25, 0.65, 0.35, 1.0)


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
        self._radius, self._height, self._lidar = robot.radius, robot.height, lidar
        self._wall_height = max(WALL_HEIGHT, lidar.height + HEADROOM)
        self._pedestrian_height = self._wall_height + PEDESTRIAN_HEIGHT - WALL_HEIGHT
        self._scan_height = floor + lidar.height
        self._directions = beam_directions(*lidar.beams).numpy()
        self.forget()

    def forget(self) -> None:
        """Clear the lists of bodies after the client has removed them."""
        self.bodies: list[int] = []
        self._people: list[list[int]] = []
        self._pedestrians: set[int] = set()
        self._untouched: set[int] = set()

    def build(self, scenario: dict[str, Tensor]) -> None:
        """Replace all bodies.

        Args:
            scenario: One row of a :class:`navrl.worlds.ScenarioBatch`, present pedestrians first.
        """
        for body in self.bodies:
            self._client.removeBody(body)
        self.forget()
        walls = scenario["boxes"][: scenario["num_boxes"]].tolist()
        self._add_walls(scenario, walls)
        kinds = (scenario[name] for name in ("ped_half", "ped_body", "ped_leg_radius"))
        present = scenario["ped_present"]
        for person in zip(*(kind[present].tolist() for kind in kinds), strict=True):
            self._people.append(self._person_bodies(*person))
        self._pedestrians = {body for bodies in self._people for body in bodies}
        height = max(ROBOT_HEIGHT, 2.0 * max(self._lidar.height, self._height))
        self._robot = robot_body(self._client, self._radius, height)
        self.bodies.append(self._robot)
        self._view = bounds(walls or [[*scenario["goal"].tolist(), 3.0, 3.0, 0.0]])
        self._add_surroundings(scenario)

    def _add_walls(self, scenario: dict[str, Tensor], walls: list[list[float]]) -> None:
        """Add the obstacles that the lidar sees or the hull can touch, all at full height."""
        row = ScenarioBatch.from_tensors({k: value[None] for k, value in scenario.items()})
        flags = visibility(row, self._lidar.height, self._height)[0].tolist()
        for wall, is_disc, (is_seen, is_touched) in zip(
            walls, scenario["box_is_disc"].tolist(), flags, strict=False
        ):
            if not (is_seen or is_touched):
                continue
            prism = DISC if is_disc else BOX
            body = self._prism(prism, wall[2], wall[3], self._wall_height, WALL_COLOR)
            self._move(body, wall[0], wall[1], 0.5 * self._wall_height, wall[4])
            self._set_role(body, is_seen, is_touched)

    def _person_bodies(self, half: list[float], kind: int, leg_radius: float) -> list[int]:
        """Return the bodies of a pedestrian: its body and, if it has them, two legs."""
        prism = BOX if kind == BODY_BOX else DISC
        size = (self._pedestrian_height, PEDESTRIAN_COLOR)
        body = self._prism(prism, half[0], half[1], *size)
        if kind != BODY_LEGS:
            return [body]
        self._set_role(body, is_seen=False, is_touched=True)
        legs = [self._prism(DISC, leg_radius, leg_radius, *size) for _ in range(2)]
        return [body, *legs]

    def _set_role(self, body: int, is_seen: bool, is_touched: bool) -> None:
        """Restrict a body that only the lidar or only the hull meets."""
        if is_seen and is_touched:
            return
        group = SEEN_GROUP if is_seen else TOUCHED_GROUP
        self._client.setCollisionFilterGroupMask(body, -1, group, -1)
        if not is_touched:
            self._untouched.add(body)

    def _prism(self, prism: tuple, hx: float, hy: float, height: float, color: tuple) -> int:
        body = prism_body(self._client, prism, [hx, hy, 0.5 * height], color)
        self.bodies.append(body)
        return body

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

    def place(self, pose: Sequence[float], states: list[list[float]]) -> None:
        """Move the robot to (x, y, yaw) and the pedestrians to ``states``."""
        x, y, yaw = pose
        self._move(self._robot, x, y, 0.0, yaw)
        middle = 0.5 * self._pedestrian_height
        for bodies, state in zip(self._people, states, strict=False):  # absent ones come last
            x, y, _, _, yaw, phase, length = state
            if math.isnan(x):  # before or after its track
                x = y = AWAY_M
                yaw = phase = length = 0.0
            self._move(bodies[0], x, y, middle, yaw)
            for side, leg in enumerate(bodies[1:]):
                center = foot_center(x, y, math.cos(yaw), math.sin(yaw), phase, length, side)
                self._move(leg, *center, middle)

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
        for body in {body for body, _ in near or ()} - {self._robot} - self._untouched:
            if inside is None:
                inside = self._surrounding_body(x, y, TOUCHED_GROUP)
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

    def _surrounding_body(self, x: float, y: float, group: int) -> int:
        """Return the body that contains (x, y), -1 if none, by a ray from above.

        ``group`` is ``SEEN_GROUP`` or ``TOUCHED_GROUP``.
        """
        top = self._floor + self._wall_height + HEADROOM
        hit = self._client.rayTest(
            (x, y, top), (x, y, self._scan_height), collisionFilterMask=STATIC_GROUP | group
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
        if self._surrounding_body(x, y, SEEN_GROUP) >= 0:
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
                [start] * len(chunk),
                chunk,
                numThreads=1,
                collisionFilterMask=STATIC_GROUP | SEEN_GROUP,
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
