"""Frozen episodes of a suite's name and version, verified by hash."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from navrl.files import write_json
from navrl.untrusted import DamagedFileError, read_json
from navrl.worlds.scenario import Scenario

FROZEN = Path(__file__).parent / "frozen"
"""Folder with one JSON file per name, written by ``navrl-suites freeze``."""

_REMEDY = "restore it: git checkout, or install navrl again"
_DIGITS = 4  # hexadecimal digits stored of each episode's hash


class FrozenSuiteError(ValueError):
    """Error for episodes that differ from those frozen under the suite's name and version."""


@dataclass(frozen=True)
class FrozenEpisodes:
    """Hashes of a suite's frozen episodes.

    Args:
        name: Name of the suite. version: Version, incremented when an episode changes.
        sha256: Hash of the first n episodes, by n; the largest n is the number of episodes.
        digests: First digits of each episode's hash, so that a subset can be checked.
    """

    name: str
    version: int
    sha256: dict[int, str] = field(repr=False)
    digests: tuple[str, ...] = field(repr=False)

    @classmethod
    def of(
        cls, name: str, version: int, scenarios: Sequence[Scenario], lengths: Sequence[int] = ()
    ) -> FrozenEpisodes:
        """Freeze ``scenarios``; ``lengths`` are those of subsets with their own hash."""
        wanted = sorted({*lengths, len(scenarios)})
        hashes = {length: episodes_hash(scenarios[:length]) for length in wanted}
        return cls(name, version, hashes, tuple(map(_digest, scenarios)))

    def check(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """Compare generated episodes with the frozen ones.

        Args:
            indices: Indices of the episodes.
            scenarios: The episodes.

        Raises:
            FrozenSuiteError: If an episode differs or its index is too large; the message has the
                suite and the expected and computed hashes.
        """
        suite = f"suite {self.name}, version {self.version}"
        if max(indices, default=0) >= len(self.digests):
            raise FrozenSuiteError(
                f"{suite}: has {len(self.digests)} episodes, episode {max(indices)} is not "
                "frozen; suite.version=null plays it unchecked"
            )
        is_first_part = list(indices) == list(range(len(scenarios)))
        if is_first_part and len(scenarios) in self.sha256:
            want, got = self.sha256[len(scenarios)], episodes_hash(scenarios)
        else:
            want = ",".join(self.digests[index] for index in indices)
            got = ",".join(map(_digest, scenarios))
        if want == got:
            return
        pairs = zip(indices, scenarios, strict=True)
        different = [index for index, one in pairs if self.digests[index] != _digest(one)]
        share = f"{len(different)} of {len(scenarios)} differ: {_short(str(different))}"
        raise FrozenSuiteError(
            f"{suite}: these are not the frozen episodes, expected {_short(want)}, found "
            f"{_short(got)}; {share}; a suite of other episodes needs another "
            "suite.name and suite.version=null"
        )

    def save(self, folder: Path = FROZEN) -> Path:
        """Write ``<name>.json``."""
        file = folder / f"{self.name}.json"
        plain = {
            "name": self.name,
            "version": self.version,
            "sha256": {str(length): value for length, value in self.sha256.items()},
            "digests": "".join(self.digests),
        }
        return write_json(file, plain, indent=1)

    @classmethod
    def load(cls, file: Path) -> FrozenEpisodes:
        """Read a file written by :meth:`save`.

        Raises:
            DamagedFileError: If the file is damaged or has other content.
        """
        plain = read_json(file, _REMEDY)
        try:
            text = plain["digests"]
            digests = tuple(text[k : k + _DIGITS] for k in range(0, len(text), _DIGITS))
            hashes = {int(length): value for length, value in plain["sha256"].items()}
            if max(hashes) != len(digests):
                raise ValueError(f"{len(digests)} digests of {max(hashes)} episodes")
            return cls(plain["name"], plain["version"], hashes, digests)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            reason = f"no frozen episodes ({type(error).__name__}: {error})"
            raise DamagedFileError(file, reason, _REMEDY) from error


@functools.cache
def frozen_episodes(name: str, version: int) -> FrozenEpisodes:
    """Return the episodes frozen under ``name`` and ``version``.

    Raises:
        FrozenSuiteError: If there are none, or only of another version.
    """
    file = FROZEN / f"{name}.json"
    if not file.is_file():
        raise FrozenSuiteError(
            f"suite {name}, version {version}: nothing is frozen under this name; "
            f"suite.version=null plays it unchecked; names are {', '.join(frozen_names())}"
        )
    frozen = FrozenEpisodes.load(file)
    if frozen.version != version:
        raise FrozenSuiteError(
            f"suite {name}: expected version {frozen.version}, found version {version}"
        )
    return frozen


def frozen_names() -> list[str]:
    """Return the names under which episodes are frozen."""
    return sorted(file.stem for file in FROZEN.glob("*.json"))


def episodes_hash(scenarios: Sequence[Scenario]) -> str:
    """Return the SHA-256 of all scenarios' fingerprints, as hexadecimal digits."""
    digest = hashlib.sha256()
    for scenario in scenarios:
        digest.update(scenario.fingerprint().encode() + b"\n")
    return digest.hexdigest()


def _digest(scenario: Scenario) -> str:
    return hashlib.sha256(scenario.fingerprint().encode()).hexdigest()[:_DIGITS]


def _short(text: str) -> str:
    return text if len(text) <= 64 else f"{text[:61]}..."
