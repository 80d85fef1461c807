"""Evaluations side by side: one table for each suite and simulator, read from their files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from navrl.evaluation.pairing import (
    MetricComparison,
    compare_metrics,
    finished_by_all,
    success_difference,
)
from navrl.evaluation.seeds import SeedSummary, over_seeds, split_seed
from navrl.evaluation.statistics import Estimate, bootstrap_mean, wilson_interval
from navrl.evaluation.stored import Evaluation, check_same_episodes, find_evaluations

CHEATING = ("orca", "oracle")
"""Controllers that read the true state, which no lidar gives."""

_RATES = ("success", "collision", "timeout")


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
        common_time: s to the goal, mean over the episodes that all policies of the table win.
        difference: Success rate less the reference's, on the same episodes; ``None`` of the
            reference itself and where there is none.
        difference_interval: 95 % paired bootstrap interval of it; ``None`` likewise.
        p_value: Of that difference, exact McNemar test; ``None`` likewise.
        metrics: Every other metric, with intervals and paired differences.
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
    common_time: Estimate
    difference: float | None
    difference_interval: tuple[float, float] | None
    p_value: float | None
    metrics: Sequence[MetricComparison]
    published: Mapping[str, float]
    cheats: bool
    folder: str


@dataclass(frozen=True)
class ComparisonTable:
    """Policies on the same episodes of the same simulator, the most successful first.

    Args:
        suite: Name.
        suite_hash: Of its episodes.
        simulator: Name.
        reference: What others are compared with; ``None`` if it is not among them.
        rows: One a policy.
        finished_by_all: Number of episodes that all of them win.
        seeds: Approaches that were trained with several seeds.
    """

    suite: str
    suite_hash: str
    simulator: str
    reference: str | None
    rows: Sequence[ComparisonRow]
    finished_by_all: int
    seeds: Sequence[SeedSummary]


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
    return [_table(setting, _labelled(members), reference) for setting, members in groups.items()]


def compare_folders(folders: Sequence[str | Path], reference: str | None = None) -> ComparisonTable:
    """Put all evaluations in some folders side by side, on whichever simulator they were played.

    Args:
        folders: Searched with all below them.
        reference: Label of what the others are compared with; the first evaluation if ``None``.

    Raises:
        ValueError: If they did not play the same episodes, or there is no such reference.
    """
    evaluations = find_evaluations(folders)
    check_same_episodes(evaluations)
    simulators = sorted({evaluation.setting[2] for evaluation in evaluations})
    by_label = _labelled(evaluations, with_simulator=len(simulators) > 1)
    if reference is None:
        reference = next(iter(by_label))
    elif reference not in {split_seed(label)[0] for label in by_label} | by_label.keys():
        raise ValueError(f"reference={reference}: need one of {sorted(by_label)}")
    suite, suite_hash, _ = evaluations[0].setting
    return _table((suite, suite_hash, " and ".join(simulators)), by_label, reference)


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
    setting: tuple[str, str, str], by_label: Mapping[str, Evaluation], reference: str
) -> ComparisonTable:
    published = published_figures().get(setting[0], {})
    finished = finished_by_all(list(by_label.values()))
    rows = []
    for label, evaluation in by_label.items():
        other = by_label.get(_reference_of(label, reference, by_label))
        if other is evaluation:
            other = None
        rows.append(_row(label, evaluation, other, finished, published))
    rows.sort(key=lambda row: (-row.rates["success"], row.policy))
    has_reference = any(row.difference is not None for row in rows) or reference in by_label
    return ComparisonTable(
        *setting,
        reference=reference if has_reference else None,
        rows=rows,
        finished_by_all=len(finished),
        seeds=over_seeds(by_label),
    )


def _row(
    label: str,
    evaluation: Evaluation,
    reference: Evaluation | None,
    finished: set[int],
    published: Mapping,
) -> ComparisonRow:
    summary = evaluation.summary
    total = int(summary["episodes"])
    rates = {name: float(summary[f"{name}_rate"]) for name in _RATES}
    counts = {name: round(rate * total) for name, rate in rates.items()}
    difference = interval = p_value = None
    if reference is not None:
        found, p_value = success_difference(evaluation, reference)
        difference, interval = found.value, (found.low, found.high)
    times = evaluation.finite("time_s")
    return ComparisonRow(
        policy=label,
        episodes=total,
        errors=int(summary.get("errors", 0)),
        rates=rates,
        intervals={name: wilson_interval(counts[name], total) for name in _RATES},
        time_s=summary.get("navigation_time_s"),
        common_time=bootstrap_mean([times[index] for index in sorted(finished)]),
        difference=difference,
        difference_interval=interval,
        p_value=p_value,
        metrics=compare_metrics(evaluation, reference, finished),
        published=published.get(split_seed(label)[0], {}),
        cheats=summary["policy"] in CHEATING,
        folder=str(evaluation.folder),
    )


def _labelled(
    evaluations: Sequence[Evaluation], with_simulator: bool = False
) -> dict[str, Evaluation]:
    """Name evaluations so that no two share a name: by their folders where they would."""
    labels = [f"{e.label}, {e.setting[2]}" if with_simulator else e.label for e in evaluations]
    for place in (lambda e: e.folder.parent.name, lambda e: str(e.folder)):
        labels = [
            label if labels.count(label) == 1 else f"{label} ({place(evaluation)})"
            for label, evaluation in zip(labels, evaluations, strict=True)
        ]
    return dict(zip(labels, evaluations, strict=True))


def _reference_of(label: str, reference: str, known: Iterable[str]) -> str:
    """Return the label of what a run is compared with: the reference of its own seed, if any."""
    seed = split_seed(label)[1]
    if seed is not None:
        for other in known:
            if split_seed(other) == (reference, seed):
                return other
    return reference
