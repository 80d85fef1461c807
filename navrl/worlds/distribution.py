"""Distribution of scenarios, sampled by (suite, seed, index)."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from navrl.worlds.layout import World
from navrl.worlds.pedestrians import PedestrianPlacer
from navrl.worlds.planner import Grid, NoPathError, plan, start_pose
from navrl.worlds.scenario import Pedestrian, Scenario

_TRIES = 50


@dataclass(frozen=True)
class WeightedWorld:
    """World generator with its relative frequency."""

    world: World
    weight: float = 1.0


class ScenarioDistribution:
    """Sample scenarios: worlds, paths and pedestrians.

    Args:
        worlds: Generator and weight by name; ``None`` removes one.
        num_dynamic: (min, max) dynamic pedestrians, uniform.
        num_static: (min, max) static pedestrians, uniform.
        speed: (min, max) m/s of dynamic pedestrians, uniform.
        half_size: Half sides of every pedestrian's cuboid, m.
        has_walls: Whether walls remain after planning (the paper's open-space test removes them).
        keep_dynamic: Number of placed dynamic pedestrians to use, ``None`` for all. Distributions
            that differ only here are equal otherwise, static pedestrians included.

    Raises:
        ValueError: If a range is not ordered, a count negative or fractional, a speed or size not
            positive, or no world has a positive weight.

    Reference:
        Paper Sec. IV-F: 1 to N_dyn^max dynamic and 1 to 2 static pedestrians at 0.5 to 1.0 m/s.
    """

    def __init__(
        self,
        worlds: Mapping[str, WeightedWorld | None],
        num_dynamic: Sequence[int] = (1, 2),
        num_static: Sequence[int] = (1, 2),
        speed: Sequence[float] = (0.5, 1.0),
        half_size: Sequence[float] = (0.15, 0.15),
        has_walls: bool = True,
        keep_dynamic: int | None = None,
    ) -> None:
        ranges = {"num_dynamic": num_dynamic, "num_static": num_static, "speed": speed}
        for name, bounds in ranges.items():
            if np.shape(bounds) != (2,) or not 0 <= bounds[0] <= bounds[1] < np.inf:
                shown = np.array(bounds).tolist()
                raise ValueError(f"{name}={shown}: must be two finite numbers, 0 <= min <= max")
            if name != "speed" and any(int(bound) != bound for bound in bounds):
                raise ValueError(f"{name}={list(bounds)}: must be integers")
        if np.shape(half_size) != (2,):
            raise ValueError(f"half_size={half_size}: must be two numbers")
        if not (speed[0] > 0 and 0 < half_size[0] < np.inf and 0 < half_size[1] < np.inf):
            raise ValueError(
                f"speed={list(speed)}, half_size={list(half_size)}: must be > 0; num_static "
                "places stationary pedestrians"
            )
        self.worlds = {name: item for name, item in worlds.items() if item is not None}
        weights = np.array([item.weight for item in self.worlds.values()])
        if not (weights >= 0).all() or not weights.sum() > 0:
            raise ValueError(f"worlds={list(self.worlds)}: weights must be >= 0 and not all 0")
        self._shares = weights / weights.sum()
        self.num_dynamic, self.num_static = tuple(num_dynamic), tuple(num_static)
        self.speed, self.half_size = tuple(speed), (half_size[0], half_size[1])
        allowed = range(int(num_dynamic[0]) + 1)
        if keep_dynamic is not None and keep_dynamic not in allowed:
            raise ValueError(
                f"keep_dynamic={keep_dynamic}: must be an integer in 0 to {num_dynamic[0]}, the "
                "minimum of num_dynamic"
            )
        self.has_walls, self.keep_dynamic = has_walls, keep_dynamic

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return scenario ``index``; the same arguments always give the same one.

        Raises:
            RuntimeError: If planning fails in many consecutive draws (an infeasible configuration).
        """
        entropy = [seed, zlib.crc32(suite.encode()), index]
        generator = np.random.default_rng(np.random.SeedSequence(entropy))
        reason = None
        for _ in range(_TRIES):
            try:
                return self._draw(generator, suite, seed, index)
            except NoPathError as error:
                reason = error
        raise RuntimeError(f"no scenario in {_TRIES} draws ({suite}, {seed}, {index}): {reason}")

    def _draw(self, generator: np.random.Generator, suite: str, seed: int, index: int) -> Scenario:
        items = list(self.worlds.values())
        world = items[generator.choice(len(items), p=self._shares)].world
        layout = world.layout(generator)
        grid = Grid(layout.boxes, layout.extent, layout.start)
        path, inflation = plan(grid, layout.start, layout.goal)
        people = self._people(
            generator,
            PedestrianPlacer(generator, grid, path, min(inflation, 0.3), half_size=self.half_size),
        )
        return Scenario(
            suite=suite,
            seed=seed,
            index=index,
            kind=world.kind,
            boxes=layout.boxes if self.has_walls else np.zeros((0, 5)),
            start=start_pose(path),
            goal=path[-1].copy(),
            path=path,
            pedestrians=people,
            noise_seed=int(generator.integers(2**32)),
        )

    def _people(
        self, generator: np.random.Generator, placer: PedestrianPlacer
    ) -> tuple[Pedestrian, ...]:
        num_dynamic = int(generator.integers(self.num_dynamic[0], self.num_dynamic[1] + 1))
        num_static = int(generator.integers(self.num_static[0], self.num_static[1] + 1))
        dynamic = [
            placer.dynamic(k, float(generator.uniform(*self.speed))) for k in range(num_dynamic)
        ]
        static = [placer.static() for _ in range(num_static)]
        return (*dynamic[: self.keep_dynamic], *static)
