"""Episodes in places: starts, goals, paths and pedestrians."""

from __future__ import annotations

import itertools
import zlib
from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from contextlib import suppress
from typing import Generic, TypeVar

import numpy as np

from navrl.checks import check_positive
from navrl.ops.bodies import BODIES, BODY_HEIGHT_M
from navrl.worlds.pedestrian import Pedestrian
from navrl.worlds.pedestrians import simplify
from navrl.worlds.places.floor import Floor, make_floor
from navrl.worlds.places.place import Place
from navrl.worlds.places.start import check_start
from navrl.worlds.places.tracks import window
from navrl.worlds.planner import NoPathError
from navrl.worlds.scenario import Scenario

Key = TypeVar("Key", bound=Hashable)

_TRIES = 200
_MAX_WITHOUT_WALK = 3  # draws of an episode without a route for a pedestrian
_MAX_FLOORS = 16  # a map of 15 m x 15 m takes 1.5 MB
_MIN_ROUTE_M = 2.0  # m, length of a pedestrian's route
_BODY_RADIUS_M = 0.2  # m, half the depth of a standing adult's shoulders and chest; ours
_APART_M = 1.2  # m between stationary pedestrians, and from them to the goal


class PlaceEpisodes(ABC, Generic[Key]):
    """Base class of distributions of episodes in places.

    A subclass returns the key of each episode's place, and the place of a key.

    Args:
        distance: (min, max) length of the path from start to goal, m.
        robot_radius: Radius of the robot that the paths are planned for, m.
        robot_height: Its height, m: lower obstacles are planned around.
        margin: Smallest distance between hull and obstacles on the path, m.
        comfort: Distance from obstacles from which on the path does not keep away from them, m.
        goal_clearance: Minimum distance of start and goal to obstacles, m.
        num_walkers: (min, max) pedestrians that walk between random points, uniform. Recorded
            pedestrians of a place are added to them.
        meeting: Share of those that walk through a random point of the robot's path.
        num_standing: (min, max) stationary pedestrians at random open points, uniform; fewer if
            there is no such point.
        speed: (min, max) of those that walk, m/s.
        body: Body of both, see :class:`navrl.worlds.Pedestrian`; of several, each pedestrian has
            one at random.
        duration_s: Duration of the part of a recording that an episode uses, s.
        walker_clearance: Minimum distance of the routes of those that walk to all obstacles that
            begin below 1.8 m, m; ``None`` plans them on the robot's map, on which routes lead under
            tables and through gaps where reactive pedestrians get stuck.

    Raises:
        ValueError: If a value is out of range.
    """

    def __init__(
        self,
        distance: Sequence[float] = (3.0, 15.0),
        robot_radius: float = 0.178,
        robot_height: float = 0.5,
        margin: float = 0.05,
        comfort: float = 0.6,
        goal_clearance: float = 0.25,
        num_walkers: Sequence[int] = (0, 0),
        meeting: float = 0.0,
        num_standing: Sequence[int] = (0, 0),
        speed: Sequence[float] = (0.5, 1.0),
        body: str | Sequence[str] = "legs",
        duration_s: float = 60.0,
        walker_clearance: float | None = None,
    ) -> None:
        """Check the values."""
        check_positive(robot_radius=robot_radius, robot_height=robot_height, margin=margin)
        check_positive(goal_clearance=goal_clearance, duration_s=duration_s)
        if walker_clearance is not None:
            check_positive(walker_clearance=walker_clearance)
        pairs = {"distance": distance, "speed": speed}
        counts = {"num_walkers": num_walkers, "num_standing": num_standing}
        for name, bounds in {**pairs, **counts}.items():
            least = 0 if name in counts else 1e-6
            if len(bounds) != 2 or not least <= bounds[0] <= bounds[1] < np.inf:
                raise ValueError(f"{name}={list(bounds)}: must be two numbers, min <= max")
        if goal_clearance > comfort:
            raise ValueError(f"goal_clearance={goal_clearance}: must be <= comfort={comfort} m")
        if not 0 <= meeting <= 1:
            raise ValueError(f"meeting={meeting}: must be in [0, 1]")
        self.bodies = (body,) if isinstance(body, str) else tuple(body)
        for name in self.bodies or ("",):
            if name not in BODIES:
                raise ValueError(f"body={name!r}: must be one of {', '.join(BODIES)}")
        self.distance, self.speed, self.meeting = tuple(distance), tuple(speed), meeting
        self.num_walkers = (int(num_walkers[0]), int(num_walkers[1]))
        self.num_standing = (int(num_standing[0]), int(num_standing[1]))
        self.robot_height, self.goal_clearance = robot_height, goal_clearance
        self.clearance, self.comfort = robot_radius + margin, comfort
        self.duration_s, self.walker_clearance = duration_s, walker_clearance
        self._floors: dict[Key, tuple[Floor, Floor]] = {}  # of robot and walkers, the last places

    def __getstate__(self) -> dict:
        """Return the state without maps, for worker processes."""
        return {**vars(self), "_floors": {}}

    @abstractmethod
    def key_of(self, suite: str, seed: int, index: int) -> Key:
        """Return the key of an episode's place; no other place has it."""

    @abstractmethod
    def make_place(self, key: Key) -> Place:
        """Return the place of a key."""

    def floor(self, key: Key) -> Floor:
        """Return a place with its map and free cells; the last few are retained."""
        return self._both_floors(key)[0]

    def _both_floors(self, key: Key) -> tuple[Floor, Floor]:
        """Return the floor of the robot and that of the pedestrians that walk."""
        if key not in self._floors:
            if len(self._floors) >= _MAX_FLOORS:
                self._floors.pop(next(iter(self._floors)))
            place = self.make_place(key)
            robots = walkers = make_floor(
                place,
                height=self.robot_height,
                clearance=self.clearance,
                comfort=self.comfort,
                cell_clearance=self.goal_clearance,
            )
            if self.walker_clearance is not None and self.num_walkers[1]:
                walkers = make_floor(
                    place,
                    height=BODY_HEIGHT_M,
                    clearance=self.walker_clearance,
                    comfort=max(self.comfort, 1.5 * self.walker_clearance),
                    cell_clearance=self.walker_clearance,
                    is_closed=robots.is_closed,
                )
            self._floors[key] = robots, walkers
        return self._floors[key]

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return episode ``index``; the same arguments always give the same one.

        Raises:
            ValueError: If no episode is found in many draws.
        """
        entropy = [seed, zlib.crc32(suite.encode()), index]
        generator = np.random.default_rng(np.random.SeedSequence(entropy))
        floor, of_walkers = self._both_floors(self.key_of(suite, seed, index))
        place = floor.place
        reason, without_walk = None, 0
        for _ in range(_TRIES):
            try:
                people = self._recorded(generator, place)
                start, path = self._route(generator, floor)
                people += self._walkers(generator, of_walkers, path)
                people += self._standing(generator, floor, path[-1])
                check_start(start, people)
            except NoPathError as error:
                reason = error
                without_walk += isinstance(error, _NoWalkError)
                if without_walk == _MAX_WITHOUT_WALK:
                    break
                continue
            return Scenario(
                suite=suite,
                seed=seed,
                index=index,
                kind=place.name,
                boxes=place.boxes,
                start=start,
                goal=path[-1].copy(),
                path=path,
                pedestrians=people,
                noise_seed=int(generator.integers(2**32)),
                num_furniture=place.num_furniture,
                discs=place.discs,
                heights=place.heights,
            )
        raise ValueError(
            f"no episode found in place {place.name} ({suite}, {seed}, {index}): {reason}"
        )

    def _route(self, generator: np.random.Generator, floor: Floor) -> tuple[np.ndarray, np.ndarray]:
        """Return the start pose and the path."""
        place, grid = floor.place, floor.grid
        if place.start is not None and place.goal is not None:
            return place.start, grid.path(place.start[:2], place.goal)
        a, b = (self._point(generator, floor) for _ in range(2))
        low, high = self.distance
        if not np.hypot(*(b - a)) <= high or not grid.connected(a, b):
            raise NoPathError(f"start and goal are too far apart for distance={[low, high]}")
        path = grid.path(a, b)
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        if not low <= length <= high:
            raise NoPathError(f"paths do not fit distance={[low, high]}")
        return np.array([*a, generator.uniform(-np.pi, np.pi)]), path

    def _point(self, generator: np.random.Generator, floor: Floor) -> np.ndarray:
        """Return a free point ``[2]`` m."""
        if not len(floor.cells):
            raise NoPathError(f"no point has goal_clearance={self.goal_clearance}")
        return floor.cells[generator.integers(len(floor.cells))]

    def _recorded(self, generator: np.random.Generator, place: Place) -> tuple[Pedestrian, ...]:
        """Return the pedestrians of a random part of the recording."""
        if not place.people:
            return ()
        times = [person.times for person in place.people if person.times is not None]
        first, last = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
        start_s = generator.uniform(first, max(first, last - self.duration_s))
        return window(place.people, start_s, self.duration_s)

    def _walkers(
        self, generator: np.random.Generator, floor: Floor, path: np.ndarray
    ) -> tuple[Pedestrian, ...]:
        """Return pedestrians that walk back and forth between two random points."""
        count = int(generator.integers(self.num_walkers[0], self.num_walkers[1] + 1))
        people = []
        for _ in range(count):
            route = self._walk(generator, floor, path)
            length = np.linalg.norm(np.diff(route, axis=0), axis=1).sum()
            offset = generator.uniform(0.0, 2.0 * length)
            speed = generator.uniform(self.speed[0], self.speed[1])
            people.append(self._person(generator, route, float(speed), float(offset)))
        return tuple(people)

    def _walk(self, generator: np.random.Generator, floor: Floor, path: np.ndarray) -> np.ndarray:
        """Return a route ``[R, 2]`` m; with ``walker_clearance`` it is drawn until one exists."""
        if self.walker_clearance is None:
            return self._drawn_walk(generator, floor, path)
        # Once: of the routes that meet fewer exist.
        meets = bool(self.meeting) and generator.random() < self.meeting
        for _ in range(_TRIES):
            with suppress(NoPathError):
                return self._drawn_walk(generator, floor, path, meets)
        raise _NoWalkError(
            f"walker_clearance={self.walker_clearance}: no route of a pedestrian found, a smaller "
            "value or null allows more"
        )

    def _drawn_walk(
        self,
        generator: np.random.Generator,
        floor: Floor,
        path: np.ndarray,
        meets: bool | None = None,
    ) -> np.ndarray:
        points = [self._point(generator, floor) for _ in range(2)]
        if meets is None:
            meets = bool(self.meeting) and generator.random() < self.meeting
        if meets:
            points.insert(1, path[generator.integers(len(path))])
        parts = [floor.grid.path(p, q) for p, q in itertools.pairwise(points)]
        route = simplify(np.concatenate(parts), tolerance=0.05)
        if np.linalg.norm(np.diff(route, axis=0), axis=1).sum() < _MIN_ROUTE_M:
            raise NoPathError(f"a pedestrian's route is shorter than {_MIN_ROUTE_M} m")
        return route

    def _standing(
        self, generator: np.random.Generator, floor: Floor, goal: np.ndarray
    ) -> tuple[Pedestrian, ...]:
        """Return stationary pedestrians, ``comfort`` away from obstacles, so that all can pass."""
        low, high = self.num_standing
        if not high:
            return ()
        count = int(generator.integers(low, high + 1))
        clearance = floor.grid.clearance[tuple(floor.grid.index(floor.cells).T)]
        open_cells = floor.cells[clearance >= self.comfort]
        taken = [goal]
        for _ in range(count * bool(len(open_cells))):
            point = open_cells[generator.integers(len(open_cells))]
            if np.linalg.norm(np.array(taken) - point, axis=1).min() >= _APART_M:
                taken.append(point)
        return tuple(self._person(generator, point[None], 0.0, 0.0) for point in taken[1:])

    def _person(
        self, generator: np.random.Generator, route: np.ndarray, speed: float, offset: float
    ) -> Pedestrian:
        body = self.bodies[0]
        if len(self.bodies) > 1:
            body = self.bodies[generator.integers(len(self.bodies))]
        half_size = (_BODY_RADIUS_M, _BODY_RADIUS_M)
        return Pedestrian(route, speed, offset, half_size, None, body)


class _NoWalkError(NoPathError):
    """Error for a pedestrian without a route."""
