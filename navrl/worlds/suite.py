"""Named sets of scenarios."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import current_process, get_all_start_methods, get_context
from typing import Protocol

from navrl.worlds.batch import ScenarioBatch
from navrl.worlds.frozen import episodes_hash, frozen_episodes
from navrl.worlds.scenario import Scenario


class Distribution(Protocol):
    """What a suite draws from, e.g. :class:`navrl.worlds.ScenarioDistribution`."""

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return scenario ``index``; the same arguments always give the same one."""
        ...


class Suite:
    """Episodes 0 to ``num_episodes`` - 1 of a distribution, under a name and a seed.

    Args:
        name: For the reader, and part of what determines each scenario.
        seed: Likewise part of it.
        num_episodes: How many.
        distribution: What they are drawn from.
        version: Of the frozen episodes that the package knows under this name. Whatever is
            generated must be among them, so that everybody plays the same; ``None`` checks nothing.
        scenes: Takes the place of ``name`` in what determines a scenario, so that suites which
            share it share worlds and routes; ``name`` if ``None``.

    Raises:
        ValueError: If the seed is negative or there is no episode.
    """

    def __init__(
        self,
        name: str,
        seed: int,
        num_episodes: int,
        distribution: Distribution,
        version: int | None = None,
        scenes: str | None = None,
    ) -> None:
        if seed < 0:
            raise ValueError(f"seed={seed}: must be >= 0")
        if num_episodes <= 0:
            raise ValueError(f"num_episodes={num_episodes}: must be > 0")
        self.name, self.seed, self.num_episodes = name, seed, num_episodes
        self.distribution, self.version = distribution, version
        self.scenes = name if scenes is None else scenes

    def scenarios(
        self, indices: Iterable[int] | None = None, num_workers: int = 1
    ) -> list[Scenario]:
        """Generate scenarios, the same for any number of worker processes.

        Args:
            indices: Which; all if ``None``.
            num_workers: Processes to share the work; 1 stays in this one.

        Raises:
            ValueError: If an index is out of range.
            FrozenSuiteError: If one is not the frozen episode of that number.
        """
        indices = list(range(self.num_episodes) if indices is None else indices)
        for index in indices:
            if not 0 <= index < self.num_episodes:
                raise ValueError(f"index {index}: suite '{self.name}' has {self.num_episodes}")
        found = self._generate(indices, num_workers)
        if self.version is not None:
            frozen_episodes(self.name, self.version).check(indices, found)
        return found

    def _generate(self, indices: list[int], num_workers: int) -> list[Scenario]:
        sample = partial(self.distribution.sample, self.scenes, self.seed)
        # A daemonic process, as vector environments start them, may not have children.
        if num_workers <= 1 or len(indices) < 32 or current_process().daemon:
            return [sample(index) for index in indices]
        # Never fork: this process may run threads of torch and of the kernels.
        method = "forkserver" if "forkserver" in get_all_start_methods() else "spawn"
        with ProcessPoolExecutor(num_workers, mp_context=get_context(method)) as workers:
            return list(workers.map(sample, indices, chunksize=16))

    def batch(self, num_workers: int = 1) -> ScenarioBatch:
        """Return all scenarios packed."""
        return ScenarioBatch.pack(self.scenarios(num_workers=num_workers))

    def hash(self, scenarios: list[Scenario] | None = None) -> str:
        """Return the SHA-256 of all scenarios' fingerprints, as hexadecimal digits.

        Args:
            scenarios: All of them, if they were generated already.
        """
        return episodes_hash(self.scenarios() if scenarios is None else scenarios)
