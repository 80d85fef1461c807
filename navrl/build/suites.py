"""Every frozen suite, generated and held to the lock."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from omegaconf import DictConfig

from navrl.build.environment import num_threads
from navrl.config import CONF_DIR, compose, instantiate
from navrl.worlds.frozen import FrozenSuite, read_lock, write_lock

NOT_FROZEN = ("smoke",)
"""Suites of ``conf/suite`` that may change at any time."""


@dataclass(frozen=True)
class SuiteStatus:
    """How a suite stands to the lock.

    Args:
        name: Of ``conf/suite``.
        found: What is generated now; the version is the one that it has or would get.
        status: ``frozen``, ``new`` or ``changed``.
    """

    name: str
    found: FrozenSuite
    status: str


def suite_names() -> list[str]:
    """Return the names of all suites that are to be frozen."""
    names = sorted(path.stem for path in (CONF_DIR / "suite").glob("*.yaml"))
    return [name for name in names if name not in NOT_FROZEN]


def check_suites(cfg: DictConfig) -> Iterator[SuiteStatus]:
    """Generate suites one by one and compare them with the lock; write it if ``cfg.write``.

    Args:
        cfg: A composed ``conf/suites.yaml``.

    Yields:
        How each stands.

    Raises:
        ValueError: If a suite's name differs from its file's, which would hide it from the lock.
    """
    names: Sequence[str] = suite_names() if cfg.suites is None else list(cfg.suites)
    lock = read_lock()
    for name in names:
        suite = instantiate(compose("evaluate", [f"suite={name}"]).suite)
        if suite.name != name:
            raise ValueError(f"conf/suite/{name}.yaml: need name: {name}, got {suite.name}")
        sha256 = suite.hash(suite.scenarios(num_workers=num_threads(cfg)))
        known = lock.get(name)
        same = known is not None and (known.episodes, known.sha256) == (suite.num_episodes, sha256)
        version = 1 if known is None else known.version + (not same)
        found = FrozenSuite(version, suite.num_episodes, sha256)
        lock[name] = found
        yield SuiteStatus(name, found, "frozen" if same else "changed" if known else "new")
    if cfg.write:
        write_lock(lock)
