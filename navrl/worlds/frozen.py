"""Frozen suites: episodes that are the same for everybody, held to a hash in the package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from navrl.worlds.scenario import Scenario
from navrl.worlds.suite import Suite

LOCK = Path(__file__).with_name("suites.lock.yaml")
"""Version, number of episodes and hash of each frozen suite, by name."""

_HEADER = """\
# Episodes of the frozen suites: `navrl-suites` checks them, `navrl-suites write=true` adds new
# ones.
# A suite whose episodes have to change gets a new version; results of different versions are of
# different episodes and are never compared.
"""


class SuiteMismatchError(ValueError):
    """A frozen suite's scenarios are not those that were frozen."""


@dataclass(frozen=True)
class FrozenSuite:
    """What the lock says of a suite.

    Args:
        version: Counts the times that its episodes were changed, from 1.
        episodes: Number.
        sha256: :meth:`Suite.hash`.
    """

    version: int
    episodes: int
    sha256: str


def read_lock(file: Path = LOCK) -> dict[str, FrozenSuite]:
    """Return the frozen suites by name."""
    entries = yaml.safe_load(file.read_text()) if file.is_file() else None
    return {name: FrozenSuite(**entry) for name, entry in (entries or {}).items()}


def write_lock(suites: Mapping[str, FrozenSuite], file: Path = LOCK) -> None:
    """Write the frozen suites, in the order given."""
    entries = {name: dict(vars(entry)) for name, entry in suites.items()}
    file.write_text(_HEADER + yaml.safe_dump(entries, sort_keys=False))


def check_frozen(
    suite: Suite, scenarios: Sequence[Scenario], lock: Mapping[str, FrozenSuite] | None = None
) -> tuple[str, int | None]:
    """Hash a suite's scenarios and hold them to the lock.

    A suite that the lock does not know, or with another number of episodes, is somebody's own and
    is not checked.

    Args:
        suite: The suite.
        scenarios: All of its scenarios.
        lock: The package's own if ``None``.

    Returns:
        The hash, and the version of the frozen suite; ``None`` if it is not frozen.

    Raises:
        SuiteMismatchError: If the scenarios are others than those frozen, naming both hashes.
    """
    found = suite.hash(list(scenarios))
    frozen = (read_lock() if lock is None else lock).get(suite.name)
    if frozen is None or frozen.episodes != len(scenarios):
        return found, None
    if found != frozen.sha256:
        raise SuiteMismatchError(
            f"suite={suite.name}: its {len(scenarios)} scenarios are not those frozen as version "
            f"{frozen.version}: expected hash {frozen.sha256}, found {found}. A suite that is "
            "changed on purpose needs another name (suite.name=mine); if nothing was changed, a "
            "library draws other numbers than the one it was frozen with"
        )
    return found, frozen.version
