"""Suites: named sets of scenarios."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import current_process
from typing import Protocol

from tqdm import tqdm

from navrl.processes import worker_context
from navrl.progress_bar import progress_bar
from navrl.worlds.batch import ScenarioBatch
from navrl.worlds.frozen import episodes_hash, frozen_episodes
from navrl.worlds.scenario import Scenario

_DELAY_S = 2.0  # s; generation that is faster shows no progress


class Distribution(Protocol):
    """Interface of a suite's distribution, e.g. :class:`navrl.worlds.ScenarioDistribution`."""

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return scenario ``index``; the same arguments always give the same one."""
        ...


class Suite:
    """Episodes 0 to ``num_episodes`` - 1 of a distribution, under a name and a seed.

    Args:
        name: Label of the suite; it also determines the scenarios, with the seed.
        seed: Seed of the scenarios.
        num_episodes: Number of episodes.
        distribution: Distribution of the scenarios.
        version: Version of the frozen episodes of this name. Generated episodes must equal them, so
            that scores are comparable; ``None`` disables the check.
        scenes: Replaces ``name`` as seed of the scenarios, so that suites with the same value share
            worlds and routes; ``name`` if ``None``.

    Raises:
        ValueError: If the seed is negative or the number of episodes is not positive.
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
        self,
        indices: Iterable[int] | None = None,
        num_workers: int = 1,
        progress: bool = False,
    ) -> list[Scenario]:
        """Generate scenarios; the result does not depend on the number of worker processes.

        Args:
            indices: Indices of the scenarios; all if ``None``.
            num_workers: Number of processes; 1 uses the current one.
            progress: Whether to show progress and remaining time, if it takes some seconds.

        Raises:
            ValueError: If an index is out of range.
            FrozenSuiteError: If one differs from the frozen episode of that index.
        """
        indices = list(range(self.num_episodes) if indices is None else indices)
        for index in indices:
            if not 0 <= index < self.num_episodes:
                raise ValueError(f"index {index}: suite '{self.name}' has {self.num_episodes}")
        found = self._generate(indices, num_workers, progress)
        if self.version is not None:
            frozen_episodes(self.name, self.version).check(indices, found)
        return found

    def _generate(self, indices: list[int], num_workers: int, progress: bool) -> list[Scenario]:
        sample = partial(self.distribution.sample, self.scenes, self.seed)
        with progress_bar(len(indices), "scenario", enabled=progress, delay_s=_DELAY_S) as bar:
            # A daemonic process, as in vector environments, cannot start children.
            if num_workers <= 1 or len(indices) < 32 or current_process().daemon:
                return list(_counted(map(sample, indices), bar))
            with ProcessPoolExecutor(num_workers, mp_context=worker_context()) as workers:
                return list(_counted(workers.map(sample, indices, chunksize=16), bar))

    def batch(self, num_workers: int = 1, progress: bool = False) -> ScenarioBatch:
        """Return all scenarios as a batch; arguments as of :meth:`scenarios`."""
        return ScenarioBatch.pack(self.scenarios(num_workers=num_workers, progress=progress))

    def hash(self, scenarios: list[Scenario] | None = None) -> str:
        """Return the SHA-256 of all scenarios' fingerprints, as hexadecimal digits.

        Args:
            scenarios: All scenarios, if already generated.
        """
        return episodes_hash(self.scenarios() if scenarios is None else scenarios)


def _counted(scenarios: Iterable[Scenario], bar: tqdm) -> Iterator[Scenario]:
    """Yield scenarios and count them."""
    for scenario in scenarios:
        bar.update()
        yield scenario
