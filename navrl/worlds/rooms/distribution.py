"""Episodes in procedural places, and mixtures of distributions."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from navrl.worlds.places.episodes import PlaceEpisodes
from navrl.worlds.places.place import Place
from navrl.worlds.scenario import Scenario
from navrl.worlds.suite import Distribution


class PlaceGenerator(Protocol):
    """Interface of generators of places, e.g. :class:`navrl.worlds.Flat`.

    The class attribute ``kind`` names the kind of world, by which results are listed.
    """

    kind: str

    def place(self, generator: np.random.Generator, name: str) -> Place:
        """Draw a place; the generator determines it."""
        ...


class GeneratedPlaces(PlaceEpisodes[tuple[str, int, int]]):
    """Episodes in places of a generator.

    Args:
        generator: Generator of the places.
        episodes_per_place: Number of successive episodes in one place, which share its map.
        episodes: Arguments of :class:`navrl.worlds.PlaceEpisodes`.

    Raises:
        ValueError: If a value is out of range.

    Example:
        >>> from navrl.worlds import Hall
        >>> GeneratedPlaces(Hall()).sample("mine", seed=0, index=3).kind
        'hall'
    """

    def __init__(
        self, generator: PlaceGenerator, episodes_per_place: int = 4, **episodes: Any
    ) -> None:
        """Check the values."""
        super().__init__(**episodes)
        if not episodes_per_place >= 1:
            raise ValueError(f"episodes_per_place={episodes_per_place}: must be >= 1")
        self.generator, self.episodes_per_place = generator, episodes_per_place

    def key_of(self, suite: str, seed: int, index: int) -> tuple[str, int, int]:
        """Return suite, seed and number of the place."""
        return suite, seed, index // self.episodes_per_place

    def make_place(self, key: tuple[str, int, int]) -> Place:
        """Draw the place of a key."""
        suite, seed, number = key
        entropy = [seed, zlib.crc32(suite.encode()), number, zlib.crc32(b"place")]
        generator = np.random.default_rng(np.random.SeedSequence(entropy))
        return self.generator.place(generator, self.generator.kind)


@dataclass(frozen=True)
class WeightedDistribution:
    """Distribution with its relative frequency.

    Args:
        distribution: Distribution of scenarios.
        weight: Relative frequency.
    """

    distribution: Distribution
    weight: float = 1.0


class MixedDistribution:
    """Scenarios of several distributions, each drawn with its relative frequency.

    Args:
        parts: Distribution and weight by name; ``None`` removes one.

    Raises:
        ValueError: If a weight is negative, or none is positive.
    """

    def __init__(self, parts: Mapping[str, WeightedDistribution | None]) -> None:
        """Check the weights."""
        self.parts = {name: part for name, part in parts.items() if part is not None}
        weights = np.array([part.weight for part in self.parts.values()], dtype=float)
        if not (weights >= 0).all() or not weights.sum() > 0:
            raise ValueError(f"parts={list(self.parts)}: weights must be >= 0 and not all 0")
        self._shares = weights / weights.sum()

    def sample(self, suite: str, seed: int, index: int) -> Scenario:
        """Return scenario ``index``; the same arguments always give the same one."""
        entropy = [seed, zlib.crc32(suite.encode()), index, zlib.crc32(b"part")]
        generator = np.random.default_rng(np.random.SeedSequence(entropy))
        number = generator.choice(len(self._shares), p=self._shares)
        return list(self.parts.values())[number].distribution.sample(suite, seed, index)
