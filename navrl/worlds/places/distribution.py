"""Episodes in places: starts, goals, paths and pedestrians, drawn by (suite, seed, index)."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navrl.checks import check_positive
from navrl.ops.bodies import BODIES
from navrl.worlds.clearance_map import ClearanceMap
from navrl.worlds.pedestrian import Pedestrian
from navrl.worlds.pedestrians import simplify
from navrl.worlds.places.folder import folder_hash, load_places
from navrl.worlds.places.place import Place
from navrl.worlds.places.tracks import window
from navrl.worlds.planner import NoPathError
from navrl.worlds.scenario import Scenario

_TRIES = 200
_MAX_MAPS = 16  # a map of 15 m x 15 m takes 1.5 MB
_START_CLEARANCE_M = 1.0  # m from the robot to pedestrians at the start


class PlaceDistribution:
    """Episodes in the places of a folder, one place after another.

    Args:
        folder: Folder with the files of :func:`navrl.worlds.load_places`.
        distance: (min, max) length of the path from start to goal, m.
        robot_radius: Radius of the robot that the paths are planned for, m.
        robot_height: Its height, m: lower obstacles are planned around.
        margin: Smallest distance between hull and obstacles on the path, m.
        comfort: Distance from obstacles from which on the path does not keep away from them, m.
        goal_clearance: Minimum distance of start and goal to obstacles, m.
        num_walkers: (min, max) pedestrians that walk between random points, uniform. Recorded
            pedestrians of a place are added to them.
        speed: (min, max) of those, m/s.
        body: Body of those, see :class:`navrl.worlds.Pedestrian`.
        duration_s: Duration of the part of a recording that an episode uses, s.
        sha256: Expected hash of the files; ``None`` for any.

    Raises:
        FileNotFoundError: If the folder does not exist.
        DamagedFileError: If a file is not usable.
        ValueError: If a value is out of range, or ``sha256`` differs.
    """

    def __init__(
        self,
        folder: str,
        distance: Sequence[float] = (3.0, 15.0),
        robot_radius: float = 0.178,
        robot_height: float = 0.5,
        margin: float = 0.05,
        comfort: float = 0.6,
        goal_clearance: float = 0.25,
        num_walkers: Sequence[int] = (0, 0),
        speed: Sequence[float] = (0.5, 1.0),
        body: str = "legs",
        duration_s: float = 60.0,
        sha256: str | None = None,
    ) -> None:
        """Read the files and check the values."""
        check_positive(robot_radius=robot_radius, robot_height=robot_height, margin=margin)
        check_positive(goal_clearance=goal_clearance, duration_s=duration_s)
        for name, bounds in (
            ("distance", distance),
            ("speed", speed),
            ("num_walkers", num_walkers),
        ):
            least = 0 if name == "num_walkers" else 1e-6
            if len(bounds) != 2 or not least <= bounds[0] <= bounds[1] < np.inf:
                raise ValueError(f"{name}={list(bounds)}: must be two numbers, min <= max")
        if goal_clearance > comfort:
            raise ValueError(f"goal_clearance={goal_clearance}: must be <= comfort={comfort} m")
        if body not in BODIES:
            raise ValueError(f"body={body!r}: must be one of {', '.join(BODIES)}")
        self.sha256 = folder_hash(folder)
        """Hash of the files."""
        if sha256 is not None and sha256 != self.sha256:
            raise ValueError(f"sha256={sha256}: the files of {folder} have {self.sha256}")
        self.places = load_places(folder)
        self.distance, self.speed, self.body = tuple(distance), tuple(speed), body
        self.num_walkers = (int(num_walkers[0]), int(num_walkers[1]))
        self.robot_height, self.goal_clearance = robot_height, goal_clearance
        self.clearance, self.comfort = robot_radius + margin, comfort
        self.duration_s = duration_s
        self._floors: dict[int, _Floor] = {}  # of the last places

    def __getstate__(self) -> dict:
        """Return the state without maps, for worker processes."""
        return {**vars(self), "_floors": {}}

    def map_of(self, number: int) -> ClearanceMap:
        """Return the map of a place by its number."""
        return self._floor(number).grid

    def _floor(self, number: int) -> _Floor:
        """Return map and free cells of a place by its number; the last few are retained."""
        if number not in self._floors:
            if len(self._floors) >= _MAX_MAPS:
                self._floors.pop(next(iter(self._floors)))
            grid = self._make_map(number)
            cells = _free_cells(self.places[number], grid, self.goal_clearance)
            self._floors[number] = _Floor(grid, cells)
        return self._floors[number]

    def _make_map(self, number: int) -> ClearanceMap:
        place = self.places[number]
        bottom, top = place.heights.T
        touched = (bottom < self.robot_height) & (top > 0.0)
        count = len(place.boxes)
        boxes, discs = place.boxes[touched[:count]], place.discs[touched[count:]]
        boxes = np.concatenate([boxes, place.limits])
        is_tight = len(place.limits) > 0
        return ClearanceMap(boxes, discs, self.clearance, self.comfort, is_tight=is_tight)

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return episode ``index``, in place ``index`` modulo the number of places.

        Raises:
            RuntimeError: If no start and goal are found in many draws.
        """
        entropy = [seed, zlib.crc32(suite.encode()), index]
        generator = np.random.default_rng(np.random.SeedSequence(entropy))
        number = index % len(self.places)
        place, floor = self.places[number], self._floor(number)
        reason = None
        for _ in range(_TRIES):
            try:
                people = self._recorded(generator, place)
                start, path = self._route(generator, place, floor)
                people += self._walkers(generator, floor)
                _check_start(start, people)
            except NoPathError as error:
                reason = error
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
        raise RuntimeError(
            f"no episode in {_TRIES} draws in place {place.name} ({suite}, {seed}, {index}): "
            f"{reason}"
        )

    def _route(
        self, generator: np.random.Generator, place: Place, floor: _Floor
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the start pose and the path."""
        grid = floor.grid
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

    def _point(self, generator: np.random.Generator, floor: _Floor) -> np.ndarray:
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

    def _walkers(self, generator: np.random.Generator, floor: _Floor) -> tuple[Pedestrian, ...]:
        """Return pedestrians that walk back and forth between two random points."""
        count = int(generator.integers(self.num_walkers[0], self.num_walkers[1] + 1))
        people = []
        for _ in range(count):
            a, b = (self._point(generator, floor) for _ in range(2))
            route = simplify(floor.grid.path(a, b), tolerance=0.05)
            length = np.linalg.norm(np.diff(route, axis=0), axis=1).sum()
            if length < 2.0:
                raise NoPathError("a pedestrian's route is shorter than 2 m")
            offset = generator.uniform(0.0, 2.0 * length)
            speed = generator.uniform(self.speed[0], self.speed[1])
            people.append(
                Pedestrian(route, float(speed), float(offset), (0.2, 0.2), None, self.body)
            )
        return tuple(people)


class _Floor(NamedTuple):
    """Map and free cells of a place.

    Args:
        grid: Map for paths.
        cells: ``[C, 2]`` m, centers of the cells with ``goal_clearance``.
    """

    grid: ClearanceMap
    cells: np.ndarray


def _free_cells(place: Place, grid: ClearanceMap, clearance: float) -> np.ndarray:
    """Return the centers ``[C, 2]`` m of free cells inside the place."""
    mask = grid.clearance >= clearance
    if place.free is None:  # the largest region; the open space around walls counts as outside
        outside = grid.regions[0, 0]
        sizes = np.bincount(grid.regions[mask & (grid.regions != outside)], minlength=2)
        sizes[0] = 0
        is_closed = bool(sizes.max() > 0)
        mask &= grid.regions == (int(sizes.argmax()) if is_closed else outside)
        return grid.centers(mask)
    cells = grid.centers(mask)
    return cells[place.free.contains(cells)]


def _check_start(start: np.ndarray, people: tuple[Pedestrian, ...]) -> None:
    """Raise ``NoPathError`` if a pedestrian is near the robot at the start."""
    for person in people:
        if person.times is not None:
            soon = np.asarray(person.times)
            at = [np.interp(np.linspace(0, 1, 6), soon, person.route[:, k]) for k in (0, 1)]
            here = (soon[0] <= 1.0) & (soon[-1] >= 0.0)
            near = here and np.hypot(at[0] - start[0], at[1] - start[1]).min()
            is_near = here and near < _START_CLEARANCE_M
        else:
            is_near = _distance_at_start(person, start) < _START_CLEARANCE_M
        if is_near:
            raise NoPathError("a pedestrian is near the robot at the start")


def _distance_at_start(person: Pedestrian, start: np.ndarray) -> float:
    arc = np.concatenate([[0.0], np.linalg.norm(np.diff(person.route, axis=0), axis=1).cumsum()])
    along = person.offset % max(2 * arc[-1], 1e-9)
    along = min(along, 2 * arc[-1] - along)
    x, y = (np.interp(along, arc, person.route[:, k]) for k in (0, 1))
    return float(np.hypot(x - start[0], y - start[1]))
