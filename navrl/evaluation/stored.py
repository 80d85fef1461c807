"""Evaluations stored in folders."""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from navrl.evaluation.metrics import METRICS, Metric
from navrl.evaluation.metrics.table import RENAMED
from navrl.evaluation.results import EPISODES, SUMMARY, columns
from navrl.evaluation.summaries import check_summary, own_metrics
from navrl.untrusted import DamagedFileError, is_number, read_json, read_table

LOG = logging.getLogger(__name__)
_TEXTS = ("scenario", "outcome")  # text columns of episodes.csv, besides the traceback in error
_REMEDY = "restore the folder, or delete this file and run the same evaluation again"

LATENCY = "latency.json"
"""File of measured latencies, if decisions were timed."""


@dataclass(frozen=True)
class Evaluation:
    """Result files of one job of ``navrl-evaluate``.

    Args:
        folder: Folder with ``summary.json`` and ``episodes.csv``.
        summary: Content of ``summary.json``.
    """

    folder: Path
    summary: Mapping

    @classmethod
    def load(cls, folder: Path) -> Evaluation:
        """Read ``summary.json``; ``episodes.csv`` is read on demand.

        Raises:
            OSError: If it is missing or not readable.
            DamagedFileError: If it is damaged or has values of the wrong type.
        """
        file = Path(folder) / "summary.json"
        summary = _renamed(read_json(file, _REMEDY))
        wrong = check_summary(summary)
        if wrong is not None:
            raise DamagedFileError(file, wrong, _REMEDY)
        return cls(Path(folder), summary)

    @property
    def label(self) -> str:
        """Name of the policy, with the changes made to it."""
        changes = self.summary.get("change") or {}
        return ", ".join([self.summary["policy"], *(f"{k}={v}" for k, v in changes.items())])

    @property
    def perturbation(self) -> str | None:
        """Name of the perturbation, ``None`` without one."""
        return (self.summary.get("perturbation") or {}).get("name")

    @property
    def setting(self) -> tuple[str, str, str]:
        """Suite, hash of its episodes and simulator, which are equal for all rows of a table.

        The name of the suite is followed by that of a perturbation, which makes another table.
        """
        known, suite = self.summary, str(self.summary["suite"])
        suite = suite if self.perturbation is None else f"{suite} under {self.perturbation}"
        return suite, str(known["suite_hash"]), str(known["simulator"])

    @property
    def setting_shown(self) -> tuple[str, str, str]:
        """:attr:`setting` with a shortened hash."""
        suite, suite_hash, simulator = self.setting
        return suite, suite_hash[:12], simulator

    @property
    def is_frozen(self) -> bool:
        """Return whether the suite was checked against the frozen one of its name.

        Older summaries without the key count as frozen.
        """
        return self.summary.get("suite_version", "older") is not None

    @cached_property
    def metrics(self) -> tuple[Metric, ...]:
        """Navrl's metrics, then the user's that were measured; the latter without function."""
        return (*METRICS, *own_metrics(self.summary))

    @cached_property
    def latency(self) -> Mapping[str, float]:
        """Result of :func:`navrl.evaluation.metrics.controller_latency`; empty if not timed."""
        return read_latency(self.folder) or {}

    @cached_property
    def episodes(self) -> dict[int, Mapping[str, str]]:
        """Return the rows of ``episodes.csv`` by index of the episode.

        Raises:
            OSError: If it is missing or not readable.
            DamagedFileError: If it is damaged, or has another number of episodes than the summary.
        """
        file = self.folder / "episodes.csv"
        rows = [_renamed(row) for row in read_table(file, _REMEDY)]
        try:
            _check_rows(rows, columns(self.metrics))
            by_index: dict[int, Mapping[str, str]] = {int(row["index"]): row for row in rows}
        except ValueError as error:
            raise DamagedFileError(file, error, _REMEDY) from error
        if len(by_index) != self.summary["episodes"]:
            found = f"has {len(by_index)} episodes, summary.json has {self.summary['episodes']}"
            raise DamagedFileError(file, found, _REMEDY)
        return by_index

    @cached_property
    def success(self) -> dict[int, bool]:
        """Return the success of the episodes, by index."""
        return {index: row["outcome"] == "success" for index, row in self.episodes.items()}

    def finite(self, column: str) -> dict[int, float]:
        """Return the finite values of a column, by index of the episode.

        Empty if an older evaluation lacks the column.
        """
        cells = {index: row.get(column) or "nan" for index, row in self.episodes.items()}
        values = {index: float(cell) for index, cell in cells.items()}
        return {index: value for index, value in values.items() if math.isfinite(value)}


def _renamed(part: Mapping) -> dict:
    """Return a part of a file with the present names of its keys, in the same order."""
    return {
        RENAMED.get(name, name): _renamed(value) if isinstance(value, Mapping) else value
        for name, value in part.items()
    }


def _check_rows(rows: Sequence[Mapping[str, str]], known: Sequence[str]) -> None:
    """Check the cells of ``episodes.csv``.

    Raises:
        ValueError: If a cell is invalid; the message has the column and row of the first one.
    """
    if not rows:
        return
    missing = [name for name in ("index", *_TEXTS) if name not in rows[0]]
    if missing:
        raise ValueError(f"columns {missing} are missing")
    numeric = [name for name in known if name not in (*_TEXTS, "error") and name in rows[0]]
    for row in rows:
        for name in numeric:
            try:
                float(row[name] or "nan")
            except ValueError:
                place = f"row of episode {row['index'][:20]}"
                raise ValueError(f"{place}: {name}={row[name][:60]!r}: must be a number") from None


def whole_results(folder: Path) -> dict | None:
    """Return the summary in a folder if it and its episodes are complete.

    A damaged file causes a warning that names it; the suite must then be played again.

    Returns:
        ``None`` if a file is missing, truncated or modified, or has no ``episodes_hash``.
    """
    try:
        evaluation = Evaluation.load(folder)
        _ = evaluation.episodes
        played = hashlib.sha256((folder / EPISODES).read_bytes()).hexdigest()
    except FileNotFoundError:
        return None
    except DamagedFileError as error:
        LOG.warning("%s: the evaluation is played again", str(error).removesuffix(f"; {_REMEDY}"))
        return None
    summary = dict(evaluation.summary)
    return summary if summary.get("episodes_hash") == played else None


def read_latency(folder: Path) -> Mapping[str, float] | None:
    """Return the content of an evaluation's ``latency.json``; ``None`` if it does not exist.

    Raises:
        DamagedFileError: If it is damaged or has values that are not numbers.
    """
    file = folder / LATENCY
    if not file.is_file():
        return None
    remedy = "delete it and time the decisions again with latency=EPISODES"
    found = read_json(file, remedy)
    wrong = [name for name, value in found.items() if not is_number(value)]
    missing = sorted({"median_ms", "p95_ms", "calls"} - found.keys())
    if wrong or missing:
        raise DamagedFileError(file, f"{wrong + missing}: must be numbers", remedy)
    return found


def find_evaluations(folders: Iterable[str | Path]) -> list[Evaluation]:
    """Return all evaluations in or below some folders, in the order of their paths.

    Raises:
        ValueError: If a folder does not exist or has no evaluation, if a file is damaged, or if
            episodes do not belong to their summary.
    """
    found: dict[Path, Evaluation] = {}
    for folder in map(Path, folders):
        files = sorted(folder.rglob(SUMMARY))
        files = [file for file in files if file.with_name(EPISODES).is_file()]
        if not files:
            raise ValueError(f"{folder}: no evaluation there ({SUMMARY} and {EPISODES})")
        for file in files:
            found[file.parent] = Evaluation.load(file.parent)
            _check_whole(found[file.parent])
    return list(found.values())


def _check_whole(evaluation: Evaluation) -> None:
    """Compare the episodes with their hash in the summary, if it has one.

    Raises:
        ValueError: If they differ.
    """
    if "episodes_hash" in evaluation.summary and whole_results(evaluation.folder) is None:
        raise ValueError(
            f"{evaluation.folder / EPISODES}: must be the episodes of {SUMMARY} beside it; "
            "play them again with the same navrl-evaluate command"
        )


def check_same_episodes(evaluations: Iterable[Evaluation]) -> None:
    """Check that evaluations played the same episodes, which pairing requires.

    Raises:
        ValueError: If they did not; the message has two folders, their suites and hashes.
    """
    first = None
    for evaluation in evaluations:
        first = first or evaluation
        for name in ("suite_hash", "episodes"):
            if evaluation.summary[name] != first.summary[name]:
                raise ValueError(f"not the same episodes: {_played(first)}, {_played(evaluation)}")


def _played(evaluation: Evaluation) -> str:
    summary = evaluation.summary
    return (
        f"{evaluation.folder} played {summary['episodes']} of {summary['suite']} "
        f"(hash {str(summary['suite_hash'])[:12]})"
    )
