"""Where pedestrians walk and stand: the first ones around the robot's path."""

from __future__ import annotations

import numpy as np

from navrl.worlds.planner import Field, Grid, NoPathError, length, resample
from navrl.worlds.scenario import MAX_ROUTE_POINTS, Pedestrian

_TRIES = 30
_CROSSING_TRIES = 4
_TOUCH = 0.3  # m between path and route at which robot and pedestrian, 0.33 m, would collide
_PASSAGE = 0.5  # m, least gap beside somebody who stands: the robot is 0.36 m wide
_OFF_ENDS = 1.2  # m from somebody who stands to the path's ends, authors' precursor


class PedestrianPlacer:
    """Sample pedestrians for one empty world.

    The first dynamic pedestrian walks the robot's path towards it, the second between two places
    beside that path, the others between places drawn anywhere, on routes that touch the path.
    Static ones stand on the path.

    Args:
        generator: Source of all randomness.
        grid: Clearance map of the world.
        path: ``[P, 2]`` m, the robot's path.
        inflation: m that routes keep off the walls where they can.
        start_clearance: m, no walker begins nearer to the robot's start.
        half_size: m, of every cuboid.

    Reference:
        Paper Sec. IV-F1: the first ones around the robot's path, and all others cross it. Standing
        on the path at least 1.2 m from its ends, and the pedestrian that walks the robot's path
        backwards, are the authors' precursor's.
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
        """Sample somebody who stands on the path and leaves a way past on every side.

        Raises:
            NoPathError: If the path has no such place left.
        """
        ends = self.path[[0, -1]]
        for _ in range(_TRIES):
            place = self.path[self.generator.integers(len(self.path))]
            place = place + self.generator.uniform(-0.3, 0.3, size=2)
            off_ends = np.linalg.norm(place - ends, axis=-1).min() >= _OFF_ENDS
            if off_ends and self._leaves_passage(place):
                self._standing.append(place)
                return Pedestrian(place[None], 0.0, 0.0, self.half_size)
        raise NoPathError("nobody can stand on the path and leave a way past")

    def _leaves_passage(self, place: np.ndarray) -> bool:
        """Whether the robot fits between ``place``'s cuboid and each wall and each other one.

        It can then walk once around each cuboid, so that none of them closes a way.
        """
        half = max(self.half_size)
        others = np.array(self._standing).reshape(-1, 2)
        between = (np.abs(others - place) - 2 * half).clip(min=0.0)
        gaps = [*self.grid.distance(place[None], half), *np.linalg.norm(between, axis=-1)]
        return min(gaps) >= _PASSAGE

    def _walker(self, route: np.ndarray, speed: float) -> Pedestrian:
        """Start somewhere on the way there or back, but not near the robot."""
        there = float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())
        for _ in range(_TRIES):
            offset = self.generator.uniform(0.0, 2 * there)
            along = min(offset, 2 * there - offset)
            if length(_at(route, along) - self.path[0]) >= self.start_clearance:
                return Pedestrian(route, speed, offset, self.half_size)
        raise NoPathError("a pedestrian's route lies wholly at the robot's start")

    def _oncoming(self) -> np.ndarray:
        """The robot's path backwards; its last part, up to a quarter, may be left out."""
        kept = self.path[round(len(self.path) * self.generator.uniform(0.0, 0.25)) :]
        return simplify(kept[::-1])

    def _beside(self) -> np.ndarray:
        """Between two places within 0.6 m of the path, at least 2 m apart."""
        for _ in range(_TRIES):
            ends = self.path[self.generator.integers(len(self.path), size=2)]
            ends = ends + self.generator.uniform(-0.6, 0.6, size=(2, 2))
            apart = length(ends[0] - ends[1]) >= 2.0
            if apart and (self.grid.clearance_at(ends) >= self.inflation).all():
                return self._route(ends[0], self._field(ends[1]))
        return self._oncoming()

    def _crossing(self) -> np.ndarray:
        """Between two places anywhere, by a route that touches the robot's path."""
        for _ in range(_CROSSING_TRIES):
            field = self._shared_field()
            start = self.grid.sample_free(self.generator, self.inflation)
            if not field.reaches(start) or length(start - field.goal) < 2.0:
                continue
            route = self._route(start, field)
            gaps = np.linalg.norm(resample(route)[:, None] - self.path[None], axis=-1)
            if gaps.min() < _TOUCH:
                return route
        return self._through()

    def _through(self) -> np.ndarray:
        """From anywhere to a point of the path and on to anywhere else, 2 m of way or more."""
        middle = self._field(self.path[self.generator.integers(len(self.path))])
        for _ in range(_TRIES):
            ends = [self.grid.sample_free(self.generator, self.inflation) for _ in range(2)]
            far = np.linalg.norm(ends - middle.goal, axis=-1).min() >= 1.0
            if far and all(middle.reaches(end) for end in ends):
                there, back = (middle.route(end) for end in ends)
                return simplify(np.concatenate([there, back[-2::-1]]))
        raise NoPathError("no route leads through the robot's path")

    def _shared_field(self) -> Field:
        """Fields cost most of a scenario's time: three goals serve all who walk anywhere."""
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
    """Drop points that lie within ``tolerance`` m of the line between those kept (Douglas-Peucker).

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
