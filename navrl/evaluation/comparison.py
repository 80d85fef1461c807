"""Evaluations side by side: one table for each suite and simulator, read from their files."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml

from navrl.evaluation.statistics import (
    PairedDifference,
    mcnemar_p_value,
    paired_difference,
    stratified_bootstrap,
    wilson_interval,
)

CHEATING = ("orca", "oracle")
"""Controllers that read the true state, which no lidar gives."""

_RATES = ("success", "collision", "timeout")


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
        """Suite, hash of its episodes and simulator: what is compared must share all three."""
        return tuple(str(self.summary[name]) for name in ("suite", "suite_hash", "simulator"))

    @cached_property
    def episodes(self) -> dict[int, Mapping[str, str]]:
        """The rows of ``episodes.csv`` by the episode's index; columns are found by name."""
        with (self.folder / "episodes.csv").open(newline="") as file:
            return {int(row["index"]): row for row in csv.DictReader(file)}

    def succeeded(self) -> dict[int, bool]:
        """Return which episodes were won."""
        return {index: row["outcome"] == "success" for index, row in self.episodes.items()}


@dataclass(frozen=True)
class ComparisonRow:
    """One policy in one table.

    Args:
        policy: Name, with what was changed about it.
        episodes: Number played.
        errors: Episodes that raised; they count as no success.
        rates: ``success``, ``collision`` and ``timeout``, in [0, 1].
        intervals: 95 % Wilson interval of each rate.
        time_s: Mean s of the successes; ``None`` without any.
        difference: Success rate less the reference's, on the same episodes; ``None`` of the
            reference itself and where there is none.
        p_value: Of that difference, exact McNemar test; ``None`` likewise.
        time_difference: s more than the reference over the episodes that both won, by a paired
            bootstrap; ``None`` likewise, and without such an episode.
        published: The paper's own figures: rates in [0, 1] and ``time`` in s; empty without any.
        cheats: Whether the true state is read.
        folder: Where the row comes from.
    """

    policy: str
    episodes: int
    errors: int
    rates: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    time_s: float | None
    difference: float | None
    p_value: float | None
    time_difference: PairedDifference | None
    published: Mapping[str, float]
    cheats: bool
    folder: str


@dataclass(frozen=True)
class SeedsRow:
    """Several trainings of one setting, from different seeds.

    Args:
        policy: Name without its seed.
        runs: Number of trainings.
        least: Success rate of the worst run.
        most: Of the best run.
        success: Interquartile mean over runs and kinds of worlds.
        interval: 95 %, stratified bootstrap over the runs.
    """

    policy: str
    runs: int
    least: float
    most: float
    success: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class ComparisonTable:
    """Policies on the same episodes of the same simulator, the most successful first.

    Args:
        suite: Name.
        suite_hash: Of its episodes.
        simulator: Name.
        reference: What others are compared with; ``None`` if it is not among them.
        rows: One a policy.
        seeds: One for several runs ``NAME_seed_K`` of one name.
    """

    suite: str
    suite_hash: str
    simulator: str
    reference: str | None
    rows: Sequence[ComparisonRow]
    seeds: Sequence[SeedsRow]


def find_evaluations(folders: Iterable[str | Path]) -> list[Evaluation]:
    """Return every evaluation in or below some folders, in the order of their paths.

    Raises:
        ValueError: If a folder does not exist or holds none.
    """
    found: dict[Path, Evaluation] = {}
    for folder in map(Path, folders):
        files = sorted(folder.rglob("summary.json"))
        files = [file for file in files if file.with_name("episodes.csv").is_file()]
        if not files:
            raise ValueError(f"{folder}: no evaluation there (summary.json and episodes.csv)")
        for file in files:
            found[file.parent] = Evaluation(file.parent, json.loads(file.read_text()))
    return list(found.values())


def compare(evaluations: Sequence[Evaluation], reference: str = "paper") -> list[ComparisonTable]:
    """Put evaluations into tables of the same episodes and the same simulator.

    Args:
        evaluations: At least one.
        reference: The policy that the others are compared with. A run ``NAME_seed_K`` is compared
            with ``<reference>_seed_K`` where there is one.

    Returns:
        A table for each suite, hash of episodes and simulator, in the order they first appear.

    Raises:
        ValueError: If there is no evaluation.
    """
    if not evaluations:
        raise ValueError("evaluations: need at least one, got none")
    groups: dict[tuple[str, str, str], list[Evaluation]] = {}
    for evaluation in evaluations:
        groups.setdefault(evaluation.setting, []).append(evaluation)
    return [_table(setting, members, reference) for setting, members in groups.items()]


def published_figures() -> dict[str, dict[str, dict[str, float]]]:
    """Return the paper's figures by suite and policy: rates in [0, 1], ``time`` in s."""
    tables = yaml.safe_load(Path(__file__).with_name("published.yaml").read_text())
    return {
        suite: {
            policy: {k: v if k == "time" else round(v / 100, 6) for k, v in figures.items()}
            for policy, figures in rows.items()
        }
        for suite, rows in tables.items()
    }


def _table(
    setting: tuple[str, str, str], members: Sequence[Evaluation], reference: str
) -> ComparisonTable:
    labels = _distinct_labels(members)
    published = published_figures().get(setting[0], {})
    by_label = dict(zip(labels, members, strict=True))
    rows = []
    for label, evaluation in by_label.items():
        other = by_label.get(_reference_of(label, reference, by_label))
        rows.append(_row(label, evaluation, other, published))
    rows.sort(key=lambda row: (-row.rates["success"], row.policy))
    has_reference = any(row.difference is not None for row in rows) or reference in by_label
    return ComparisonTable(
        *setting, reference if has_reference else None, rows, _over_seeds(by_label)
    )


def _row(
    label: str, evaluation: Evaluation, other: Evaluation | None, published: Mapping
) -> ComparisonRow:
    summary = evaluation.summary
    total = int(summary["episodes"])
    rates = {name: float(summary[f"{name}_rate"]) for name in _RATES}
    counts = {name: round(rate * total) for name, rate in rates.items()}
    difference = p_value = time_difference = None
    if other is not None and other is not evaluation:
        difference, p_value = _paired(evaluation.succeeded(), other.succeeded())
        time_difference = _time_difference(evaluation, other)
    return ComparisonRow(
        policy=label,
        episodes=total,
        errors=int(summary.get("errors", 0)),
        rates=rates,
        intervals={name: wilson_interval(counts[name], total) for name in _RATES},
        time_s=summary.get("navigation_time_s"),
        difference=difference,
        p_value=p_value,
        time_difference=time_difference,
        published=published.get(_without_seed(label), {}),
        cheats=summary["policy"] in CHEATING,
        folder=str(evaluation.folder),
    )


def _paired(mine: Mapping[int, bool], theirs: Mapping[int, bool]) -> tuple[float, float]:
    """Return the difference in success over the episodes that both played, and its p-value."""
    both = sorted(mine.keys() & theirs.keys())
    first, second = [mine[i] for i in both], [theirs[i] for i in both]
    difference = (sum(first) - sum(second)) / len(both)
    return difference, mcnemar_p_value(first, second)


def _time_difference(mine: Evaluation, theirs: Evaluation) -> PairedDifference | None:
    """Return how much longer ``mine`` took over the episodes that both won."""
    won = {i for i, success in mine.succeeded().items() if success}
    won &= {i for i, success in theirs.succeeded().items() if success}
    if not won:
        return None
    first, second = (
        [float(e.episodes[index]["time_s"]) for index in sorted(won)] for e in (mine, theirs)
    )
    return paired_difference(first, second)


def _over_seeds(by_label: Mapping[str, Evaluation]) -> list[SeedsRow]:
    groups: dict[str, list[Evaluation]] = {}
    for label, evaluation in by_label.items():
        if _without_seed(label) != label:
            groups.setdefault(_without_seed(label), []).append(evaluation)
    return [_seeds_row(name, runs) for name, runs in groups.items() if len(runs) > 1]


def _seeds_row(name: str, runs: Sequence[Evaluation]) -> SeedsRow:
    rates = [float(run.summary["success_rate"]) for run in runs]
    worlds = [run.summary.get("by_scenario") or {"all": run.summary} for run in runs]
    scores = [[part["success_rate"] for _, part in sorted(parts.items())] for parts in worlds]
    estimate = stratified_bootstrap(np.array(scores))
    interval = estimate.low, estimate.high
    return SeedsRow(name, len(runs), min(rates), max(rates), estimate.value, interval)


def _distinct_labels(members: Sequence[Evaluation]) -> list[str]:
    """Name policies so that no two share a name: by their folders where they would."""
    labels = [member.label for member in members]
    return [
        label if labels.count(label) == 1 else f"{label} ({member.folder.parent.name})"
        for label, member in zip(labels, members, strict=True)
    ]


def _reference_of(label: str, reference: str, known: Iterable[str]) -> str:
    _, marker, seed = label.rpartition("_seed_")
    same_seed = f"{reference}{marker}{seed}"
    return same_seed if marker and same_seed in known else reference


def _without_seed(label: str) -> str:
    return re.sub(r"_seed_\d+$", "", label)
