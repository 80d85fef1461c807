"""Placement of pedestrians on and around the robot's path."""

from __future__ import annotations

import numpy as np

from navrl.worlds.planner import Field, Grid, NoPathError, length, resample
from navrl.worlds.scenario import MAX_ROUTE_POINTS, Pedestrian

_TRIES = 30
_CROSSING_TRIES = 4
_MIN_GAP = 0.3  # m between path and route at which robot and pedestrian, 0.33 m, would collide
_PASSAGE = 0.5  # m, minimum gap beside a stationary pedestrian: the robot is 0.36 m wide
_END_DISTANCE = 1.2  # m from a stationary pedestrian to the path's ends, authors' precursor


class PedestrianPlacer:
    """Sampler of pedestrians for one world.

    The first dynamic pedestrian walks the robot's path in the opposite direction, the second
    between two points beside that path, the others between random points on routes that touch the
    path. Static pedestrians are on the path.

    Args:
        generator: Source of all randomness.
        grid: Clearance map of the world.
        path: ``[P, 2]`` m, the robot's path.
        inflation: Preferred distance of routes to the walls, m.
        start_clearance: Minimum distance of dynamic pedestrians to the robot's start, m.
        half_size: Half side of every cuboid, m.

    Reference:
        Paper Sec. IV-F1: the first ones are around the robot's path, and all others cross it. The
        distance of 1.2 m from static pedestrians to the path's ends, and the pedestrian that walks
        the robot's path backwards, are from the authors' precursor.
    """

    def __init__(
        self,
        generator: np.random.Generator,
        grid: Grid,
        path: np.ndarray,
        inflation: float,
        start_clearance: float = 1.2,
        half_size: tuple[float, float] = (0.15, 0.15),
    ) -> None:
        self.generator, self.grid, self.path = generator, grid, path
        self.inflation, self.start_clearance, self.half_size = (
            inflation,
            start_clearance,
            half_size,
        )
        self._fields: list[Field] = []
        self._standing: list[np.ndarray] = []

    def dynamic(self, index: int, speed: float) -> Pedestrian:
        """Sample the ``index``-th dynamic pedestrian."""
        if index == 0:
            return self._walker(self._oncoming(), speed)
        if index == 1:
            return self._walker(self._beside(), speed)
        return self._walker(self._crossing(), speed)

    def static(self) -> Pedestrian:
        """Sample a stationary pedestrian on the path that leaves a passage on every side.

        Raises:
            NoPathError: If the path has no such position.
        """
        ends = self.path[[0, -1]]
        for _ in range(_TRIES):
            place = self.path[self.generator.integers(len(self.path))]
            place = place + self.generator.uniform(-0.3, 0.3, size=2)
            off_ends = np.linalg.norm(place - ends, axis=-1).min() >= _END_DISTANCE
            if off_ends and self._leaves_passage(place):
                self._standing.append(place)
                return Pedestrian(place[None], 0.0, 0.0, self.half_size)
        raise NoPathError("no position on the path leaves a passage beside a stationary pedestrian")

    def _leaves_passage(self, place: np.ndarray) -> bool:
        """Check that the robot fits between ``place``'s cuboid and all walls and other cuboids.

        It can then drive around each cuboid, so that none of them blocks a passage.
        """
        half = max(self.half_size)
        others = np.array(self._standing).reshape(-1, 2)
        between = (np.abs(others - place) - 2 * half).clip(min=0.0)
        gaps = [*self.grid.distance(place[None], half), *np.linalg.norm(between, axis=-1)]
        return min(gaps) >= _PASSAGE

    def _walker(self, route: np.ndarray, speed: float) -> Pedestrian:
        """Return a pedestrian at a random position of its route, not near the robot."""
        there = float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())
        for _ in range(_TRIES):
            offset = self.generator.uniform(0.0, 2 * there)
            along = min(offset, 2 * there - offset)
            if length(_at(route, along) - self.path[0]) >= self.start_clearance:
                return Pedestrian(route, speed, offset, self.half_size)
        raise NoPathError("a pedestrian's whole route is too close to the robot's start")

    def _oncoming(self) -> np.ndarray:
        """Return the reversed robot's path, without up to a quarter at its end."""
        kept = self.path[round(len(self.path) * self.generator.uniform(0.0, 0.25)) :]
        return simplify(kept[::-1])

    def _beside(self) -> np.ndarray:
        """Return a route between two points within 0.6 m of the path, at least 2 m apart."""
        for _ in range(_TRIES):
            ends = self.path[self.generator.integers(len(self.path), size=2)]
            ends = ends + self.generator.uniform(-0.6, 0.6, size=(2, 2))
            apart = length(ends[0] - ends[1]) >= 2.0
            if apart and (self.grid.clearance_at(ends) >= self.inflation).all():
                return self._route(ends[0], self._field(ends[1]))
        return self._oncoming()

    def _crossing(self) -> np.ndarray:
        """Return a route between two random points that touches the robot's path."""
        for _ in range(_CROSSING_TRIES):
            field = self._shared_field()
            start = self.grid.sample_free(self.generator, self.inflation)
            if not field.reaches(start) or length(start - field.goal) < 2.0:
                continue
            route = self._route(start, field)
            gaps = np.linalg.norm(resample(route)[:, None] - self.path[None], axis=-1)
            if gaps.min() < _MIN_GAP:
                return route
        return self._through()

    def _through(self) -> np.ndarray:
        """Return a route of at least 2 m between two random points through a point of the path."""
        middle = self._field(self.path[self.generator.integers(len(self.path))])
        for _ in range(_TRIES):
            ends = [self.grid.sample_free(self.generator, self.inflation) for _ in range(2)]
            far = np.linalg.norm(ends - middle.goal, axis=-1).min() >= 1.0
            if far and all(middle.reaches(end) for end in ends):
                there, back = (middle.route(end) for end in ends)
                return simplify(np.concatenate([there, back[-2::-1]]))
        raise NoPathError("no route leads through the robot's path")

    def _shared_field(self) -> Field:
        """Return one of three shared fields, since fields take most of the generation time."""
        if len(self._fields) < 3:
            goal = self.grid.sample_free(self.generator, self.inflation)
            self._fields.append(self._field(goal))
            return self._fields[-1]
        return self._fields[self.generator.integers(len(self._fields))]

    def _field(self, goal: np.ndarray) -> Field:
        return self.grid.field(goal, self.inflation)

    def _route(self, start: np.ndarray, field: Field) -> np.ndarray:
        return simplify(field.route(start))


def simplify(points: np.ndarray, tolerance: float = 0.03) -> np.ndarray:
    """Simplify a polyline to within ``tolerance`` m by the Douglas-Peucker algorithm.

    Raises:
        NoPathError: If more than ``MAX_ROUTE_POINTS`` are left.
    """
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    stack = [(0, len(points) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        way = points[b] - points[a]
        offset = points[a + 1 : b] - points[a]
        off_line = np.abs(way[0] * offset[:, 1] - way[1] * offset[:, 0])
        off_line = off_line / max(length(way), 1e-9)
        worst = int(off_line.argmax())
        if off_line[worst] > tolerance:
            middle = a + 1 + worst
            keep[middle] = True
            stack += [(a, middle), (middle, b)]
    if keep.sum() > MAX_ROUTE_POINTS:
        raise NoPathError(f"a route has {keep.sum()} corners, at most {MAX_ROUTE_POINTS} fit")
    return points[keep]


def _at(route: np.ndarray, along: float) -> np.ndarray:
    arc = np.concatenate([[0.0], np.linalg.norm(np.diff(route, axis=0), axis=1).cumsum()])
    return np.array([np.interp(along, arc, route[:, k]) for k in range(2)])
