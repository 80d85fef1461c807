"""Listing, checking and freezing of suites."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from navrl.config import CONF_DIR, compose, instantiate
from navrl.worlds import FrozenEpisodes, Suite
from navrl.worlds.frozen import FROZEN, frozen_episodes


@dataclass(frozen=True)
class FrozenSuite:
    """Frozen suite with the overrides that select it.

    Args:
        overrides: Overrides of ``navrl-evaluate``, e.g. ``("suite=table1",)``.
        suite: The suite.
    """

    overrides: tuple[str, ...]
    suite: Suite


def frozen_suites(names: list[str] | None = None) -> list[FrozenSuite]:
    """Return all frozen suites: those of ``conf/suite`` and each level of the sweeps.

    Args:
        names: Names to select; all if empty or ``None``.

    Raises:
        ValueError: If a name does not exist.
    """
    found: dict[str, FrozenSuite] = {}
    for overrides in _choices():
        suite = instantiate(compose("evaluate", list(overrides)).suite)
        known = found.get(suite.name)
        longer = known is None or suite.num_episodes > known.suite.num_episodes
        if suite.version is not None and longer:  # table1 includes table1_200
            found[suite.name] = FrozenSuite(tuple(overrides), suite)
    unknown = sorted(set(names or ()) - found.keys())
    if unknown:
        raise ValueError(f"names={unknown}: must be some of {', '.join(sorted(found))}")
    return [found[name] for name in sorted(names or found)]


def check_frozen(entry: FrozenSuite, num_workers: int = 1) -> None:
    """Regenerate a suite's episodes and compare them with the frozen ones.

    Raises:
        FrozenSuiteError: If they differ.
    """
    entry.suite.scenarios(num_workers=num_workers)


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
    scenarios = unchecked.scenarios(num_workers=num_workers)
    lengths = [200] if len(scenarios) > 200 else []  # table1_200 has its own hash
    FrozenEpisodes.of(suite.name, suite.version, scenarios, lengths).save()
    frozen_episodes.cache_clear()
    return True


def _choices() -> Iterator[Sequence[str]]:
    for file in sorted((CONF_DIR / "suite").glob("*.yaml")):
        yield [f"suite={file.stem}"]
    for file in sorted((CONF_DIR / "sweep").glob("*.yaml")):
        params = dict(OmegaConf.load(file).hydra.sweeper.params)
        levels = {key: value for key, value in params.items() if key.split(".")[0] == "suite"}
        if levels:
            yield from itertools.product(*(_values(k, v) for k, v in levels.items()))


def _values(key: str, value: object) -> list[str]:
    override = OverridesParser.create().parse_override(f"{key}={value}")
    if not override.is_sweep_override():
        return [f"{key}={value}"]
    return [f"{key}={level}" for level in override.sweep_string_iterator()]
