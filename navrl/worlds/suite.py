"""Named sets of scenarios."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_all_start_methods, get_context
from typing import Protocol

from navrl.worlds.batch import ScenarioBatch
from navrl.worlds.scenario import Scenario


class Distribution(Protocol):
    """What scenarios are drawn from."""

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return scenario ``index``; the same arguments always give the same one."""
        ...


class Suite:
    """Episodes 0 to ``num_episodes`` - 1 of a distribution, under a name and a seed.

    Args:
        name: For the reader, and for the lock that a frozen suite's hash is held to.
        seed: Part of what determines each scenario.
        num_episodes: How many.
        distribution: What they are drawn from.
        drawn_as: Name that determines each scenario, with the seed; ``name`` if ``None``. Suites
            drawn as the same one share their layouts, as far as their distributions allow.

    Raises:
        ValueError: If the seed is negative or there is no episode.
    """

    def __init__(
        self,
        name: str,
        seed: int,
        num_episodes: int,
        distribution: Distribution,
        drawn_as: str | None = None,
    ) -> None:
        if seed < 0 or num_episodes <= 0:
            raise ValueError(f"seed={seed}: must be >= 0; num_episodes={num_episodes}: must be > 0")
        self.name, self.seed, self.num_episodes = name, seed, num_episodes
        self.distribution = distribution
        self.drawn_as = name if drawn_as is None else drawn_as

    def scenarios(
        self, indices: Iterable[int] | None = None, num_workers: int = 1
    ) -> list[Scenario]:
        """Generate scenarios, the same for any number of worker processes.

        Args:
            indices: Which; all if ``None``.
            num_workers: Processes to share the work; 1 stays in this one.

        Raises:
            ValueError: If an index is out of range.
        """
        indices = list(range(self.num_episodes) if indices is None else indices)
        for index in indices:
            if not 0 <= index < self.num_episodes:
                raise ValueError(f"index {index}: suite '{self.name}' has {self.num_episodes}")
        sample = partial(self.distribution.sample, self.drawn_as, self.seed)
        if num_workers <= 1 or len(indices) < 32:
            return [sample(index) for index in indices]
        # Never fork: this process may run threads of torch and of the kernels.
        method = "forkserver" if "forkserver" in get_all_start_methods() else "spawn"
        with ProcessPoolExecutor(num_workers, mp_context=get_context(method)) as workers:
            return list(workers.map(sample, indices, chunksize=16))

    def batch(self, num_workers: int = 1) -> ScenarioBatch:
        """Return all scenarios packed."""
        return ScenarioBatch.pack(self.scenarios(num_workers=num_workers))

    def hash(self, scenarios: list[Scenario] | None = None) -> str:
        """Return the SHA-256 of all scenarios' canonical JSON, as hexadecimal digits.

        Args:
            scenarios: All of them, if they were generated already.
        """
        digest = hashlib.sha256()
        for scenario in self.scenarios() if scenarios is None else scenarios:
            digest.update(scenario.to_json().encode() + b"\n")
        return digest.hexdigest()
