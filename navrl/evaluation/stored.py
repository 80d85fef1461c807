"""Evaluations as they lie in folders."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from navrl.evaluation.results import EPISODES, SUMMARY

LATENCY = "latency.json"
"""File beside the results with what the clock says, if decisions were timed."""


@dataclass(frozen=True)
class Evaluation:
    """What one job of ``navrl-evaluate`` left.

    Args:
        folder: With ``summary.json`` and ``episodes.csv``.
        summary: The former.
    """

    folder: Path
    summary: Mapping

    @property
    def label(self) -> str:
        """The policy, with what was changed about it."""
        changes = self.summary.get("change") or {}
        return ", ".join([self.summary["policy"], *(f"{k}={v}" for k, v in changes.items())])

    @property
    def setting(self) -> tuple[str, str, str]:
        """Suite, hash of its episodes and simulator: the rows of a table share all three."""
        return tuple(str(self.summary[name]) for name in ("suite", "suite_hash", "simulator"))

    @property
    def is_frozen(self) -> bool:
        """Whether the suite was checked against the frozen one of its name.

        Summaries without the key are older than it and taken for frozen.
        """
        return self.summary.get("suite_version", "older") is not None

    @cached_property
    def latency(self) -> Mapping[str, float]:
        """What :func:`navrl.evaluation.metrics.controller_latency` said; empty if not timed."""
        file = self.folder / LATENCY
        return json.loads(file.read_text()) if file.is_file() else {}

    @cached_property
    def episodes(self) -> dict[int, Mapping[str, str]]:
        """The rows of ``episodes.csv`` by the episode's index; columns are found by name."""
        with (self.folder / EPISODES).open(newline="") as file:
            return {int(row["index"]): row for row in csv.DictReader(file)}

    @cached_property
    def success(self) -> dict[int, bool]:
        """Which episodes were won, by index."""
        return {index: row["outcome"] == "success" for index, row in self.episodes.items()}

    def finite(self, column: str) -> dict[int, float]:
        """Return a column by index, of the episodes where it is a finite number.

        Empty if the evaluation is older than the column.
        """
        cells = {index: row.get(column) or "nan" for index, row in self.episodes.items()}
        values = {index: float(cell) for index, cell in cells.items()}
        return {index: value for index, value in values.items() if math.isfinite(value)}


def whole_results(folder: Path) -> dict | None:
    """Return the summary in a folder if it and the episodes it belongs to are whole.

    Returns:
        ``None`` if a file is missing, cut off or altered, or older than ``episodes_hash``.
    """
    try:
        summary = json.loads((folder / SUMMARY).read_text())
        played = hashlib.sha256((folder / EPISODES).read_bytes()).hexdigest()
    except (FileNotFoundError, ValueError):
        return None
    is_whole = isinstance(summary, dict) and summary.get("episodes_hash") == played
    return summary if is_whole else None


def find_evaluations(folders: Iterable[str | Path]) -> list[Evaluation]:
    """Return every evaluation in or below some folders, in the order of their paths.

    Raises:
        ValueError: If a folder does not exist or holds none, or episodes are not those that a
            summary counts.
    """
    found: dict[Path, Evaluation] = {}
    for folder in map(Path, folders):
        files = sorted(folder.rglob(SUMMARY))
        files = [file for file in files if file.with_name(EPISODES).is_file()]
        if not files:
            raise ValueError(f"{folder}: no evaluation there ({SUMMARY} and {EPISODES})")
        for file in files:
            found[file.parent] = Evaluation(file.parent, json.loads(file.read_text()))
            _check_whole(found[file.parent])
    return list(found.values())


def _check_whole(evaluation: Evaluation) -> None:
    """Compare the episodes with their hash in the summary, of evaluations that have one.

    Raises:
        ValueError: If they differ.
    """
    if "episodes_hash" in evaluation.summary and whole_results(evaluation.folder) is None:
        raise ValueError(
            f"{evaluation.folder / EPISODES}: does not hold the episodes of {SUMMARY} beside it; "
            "play them again with the same navrl-evaluate command"
        )


def check_same_episodes(evaluations: Iterable[Evaluation]) -> None:
    """See that evaluations played the same episodes: only then can they be paired.

    Raises:
        ValueError: Otherwise, naming two folders, their suites and hashes.
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
