"""Listing, checking and freezing of suites."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from navrl.config import CONF_DIR, compose, did_you_mean, instantiate, options
from navrl.worlds.frozen import FROZEN, FrozenEpisodes, frozen_episodes

if TYPE_CHECKING:
    from navrl.worlds import Suite


@dataclass(frozen=True)
class FrozenSuite:
    """Frozen suite with the overrides that select it.

    Args:
        overrides: Overrides of ``navrl-evaluate``, e.g. ``("suite=table1",)``.
        node: Configuration of the suite.
    """

    overrides: tuple[str, ...]
    node: DictConfig = field(repr=False)

    @property
    def name(self) -> str:
        """Name under which its episodes are frozen."""
        return self.node.name

    @property
    def version(self) -> int:
        """Version of the frozen episodes."""
        return self.node.version

    @property
    def num_episodes(self) -> int:
        """Number of episodes."""
        return self.node.num_episodes

    @cached_property
    def suite(self) -> Suite:
        """The suite, built at first use: that imports torch."""
        return instantiate(self.node)


def frozen_suites(names: list[str] | None = None) -> list[FrozenSuite]:
    """Return all frozen suites: those of ``conf/suite`` and each level of the sweeps.

    Args:
        names: Names to select; all if empty or ``None``.

    Raises:
        ValueError: If a name does not exist.
    """
    found: dict[str, FrozenSuite] = {}
    for overrides, node in _choices():
        known = found.get(node.name)
        longer = known is None or node.num_episodes > known.num_episodes
        if node.version is not None and longer:  # table1 includes table1_200
            found[node.name] = FrozenSuite(tuple(overrides), node)
    unknown = sorted(set(names or ()) - found.keys())
    if unknown:
        near = did_you_mean(unknown[0], found)
        raise ValueError(
            f"names={unknown}: no such suite{near}; there are {', '.join(sorted(found))}"
        )
    return [found[name] for name in sorted(names or found)]


def check_frozen(entry: FrozenSuite, num_workers: int = 1) -> None:
    """Regenerate a suite's episodes and compare them with the frozen ones.

    Raises:
        FrozenSuiteError: If they differ.
    """
    entry.suite.scenarios(num_workers=num_workers, progress=True)


def freeze(entry: FrozenSuite, num_workers: int = 1) -> bool:
    """Freeze a suite under its version; an existing one is compared and never replaced.

    Returns:
        Whether it was written; ``False`` if it was already frozen.

    Raises:
        FrozenSuiteError: If its version is frozen with other episodes; increase the version in
            ``conf/suite`` then.
    """
    suite = entry.suite
    file = FROZEN / f"{suite.name}.json"
    if file.is_file() and FrozenEpisodes.load(file).version == suite.version:
        check_frozen(entry, num_workers)
        return False
    unchecked = copy.copy(suite)
    unchecked.version = None
    scenarios = unchecked.scenarios(num_workers=num_workers, progress=True)
    lengths = [200] if len(scenarios) > 200 else []  # table1_200 has its own hash
    FrozenEpisodes.of(suite.name, suite.version, scenarios, lengths).save()
    frozen_episodes.cache_clear()
    return True


def _choices() -> Iterator[tuple[Sequence[str], DictConfig]]:
    """Yield the overrides that choose a suite, and its node."""
    names = options("suite")
    # One composition of all: to compose navrl-evaluate for each takes seconds.
    nodes = compose(None, [f"+suite@{name}={name}" for name in names])
    for name in names:
        yield [f"suite={name}"], nodes[name]
    for file in sorted((CONF_DIR / "sweep").glob("*.yaml")):
        params = dict(OmegaConf.load(file).hydra.sweeper.params)
        levels = {key: value for key, value in params.items() if key.split(".")[0] == "suite"}
        for overrides in itertools.product(*(_values(k, v) for k, v in levels.items())):
            if overrides:
                yield overrides, _overridden(nodes, overrides)


def _overridden(nodes: DictConfig, overrides: Sequence[str]) -> DictConfig:
    """Return the node that ``suite=NAME`` chooses, with the values of its other keys."""
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    values = {override.key_or_group: override.value() for override in parsed}
    node = nodes[values.pop("suite")].copy()
    for key, value in values.items():
        OmegaConf.update(node, key.removeprefix("suite."), value, merge=False)
    return node


def _values(key: str, value: object) -> list[str]:
    override = OverridesParser.create().parse_override(f"{key}={value}")
    if not override.is_sweep_override():
        return [f"{key}={value}"]
    return [f"{key}={level}" for level in override.sweep_string_iterator()]
