"""Comparison of evaluations: one table for each suite and simulator, read from files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import yaml

from navrl.deprecation import warn
from navrl.evaluation.pairing import (
    COLLISIONS,
    MetricComparison,
    compare_metrics,
    finished_by_all,
    success_difference,
)
from navrl.evaluation.reference import (
    check_reference,
    default_reference,
    is_privileged,
    reference_of,
)
from navrl.evaluation.seeds import SeedSummary, over_seeds, split_seed
from navrl.evaluation.statistics import Estimate, bootstrap_mean, holm, wilson_interval
from navrl.evaluation.stored import Evaluation, check_same_episodes, find_evaluations

_RATES = ("success", "collision", "timeout")


@dataclass(frozen=True)
class ComparisonRow:
    """Row of a comparison table: one policy.

    Args:
        policy: Name, with the changes made to it.
        episodes: Number of episodes.
        errors: Episodes that raised an exception; they count as failures.
        rates: ``success``, ``collision`` and ``timeout``, in [0, 1]; and the kinds of collisions,
            :data:`navrl.evaluation.pairing.COLLISIONS`, unless the evaluation is older.
        intervals: 95 % Wilson interval of each rate.
        time_s: Mean time of the successes, s; ``None`` without any.
        common_time: Mean time to the goal over the episodes in which all policies succeed, s.
        difference: Success rate minus the reference's, on the same episodes; ``None`` for the
            reference itself and without a reference.
        difference_interval: 95 % interval of the difference, NaN if unknown; ``None`` likewise.
        p_value: p-value of the difference, exact McNemar test; ``None`` likewise and for fewer than
            6 episodes.
        p_holm: The same with Holm's correction for the number of tests in the table.
        metrics: Every other metric, with intervals and paired differences.
        published: The paper's figures: rates in [0, 1] and ``time`` in s; empty if there are none,
            or if the episodes are not frozen.
        is_privileged: Whether the policy is privileged (reads the true state).
        folder: Folder of the evaluation.
        observes: What the policy may read, e.g. scan, pose and path; empty in older evaluations.
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
    p_holm: float | None
    metrics: Sequence[MetricComparison]
    published: Mapping[str, float]
    is_privileged: bool
    folder: str
    observes: tuple[str, ...] = ()

    @property
    def cheats(self) -> bool:
        """Deprecated name of :attr:`is_privileged`."""
        warn("ComparisonRow.cheats", "use is_privileged")
        return self.is_privileged


@dataclass(frozen=True)
class Lead:
    """Comparison of the best policy with the second best, both not privileged.

    Args:
        best: Label of the best policy.
        second: Label of the best policy of another approach; seeds of one approach are not
            compared.
        difference: Success rate of the best minus that of the second, on the same episodes.
        difference_interval: 95 % interval of the difference, NaN if unknown.
        p_value: p-value of the difference, exact McNemar test; ``None`` for fewer than 6 episodes.
    """

    best: str
    second: str
    difference: float
    difference_interval: tuple[float, float]
    p_value: float | None

    @property
    def is_tie(self) -> bool:
        """Return whether the two succeed equally often."""
        return self.difference == 0


@dataclass(frozen=True)
class ComparisonTable:
    """Table of policies on the same episodes and simulator, the most successful first.

    Args:
        suite: Name of the suite.
        suite_hash: Hash of its episodes.
        simulator: Name of the simulator.
        is_frozen: Whether the episodes are the frozen ones of the suite's name.
        reference: Label of the policy that the others are compared with; ``None`` if it is missing.
        rows: One row per policy.
        finished_by_all: Number of episodes in which all policies succeed.
        seeds: Approaches trained with several seeds.
        lead: Comparison of the best with the second best; ``None`` if there are not two.
    """

    suite: str
    suite_hash: str
    simulator: str
    is_frozen: bool
    reference: str | None
    rows: Sequence[ComparisonRow]
    finished_by_all: int
    seeds: Sequence[SeedSummary]
    lead: Lead | None

    @property
    def title(self) -> str:
        """Name of the suite, marked if it is not frozen."""
        return self.suite if self.is_frozen else f"{self.suite} (not frozen)"


def compare(
    evaluations: Sequence[Evaluation], reference: str | None = None
) -> list[ComparisonTable]:
    """Group evaluations into tables of the same episodes and simulator.

    Args:
        evaluations: At least one.
        reference: Policy that the others are compared with, in tables that have it; ``None`` uses
            :func:`navrl.evaluation.reference.default_reference` for each table. A run
            ``NAME_seed_K`` is compared with ``<reference>_seed_K`` if it exists.

    Returns:
        A table for each suite, hash of episodes and simulator, in order of appearance.

    Raises:
        ValueError: If there is no evaluation, or no table has the reference.
    """
    if not evaluations:
        raise ValueError("evaluations=[]: must have at least one")
    groups: dict[tuple[str, str, str], list[Evaluation]] = {}
    for evaluation in evaluations:
        groups.setdefault(evaluation.setting, []).append(evaluation)
    tables = {setting: _labelled(members) for setting, members in groups.items()}
    if reference is not None:
        check_reference(reference, [label for by_label in tables.values() for label in by_label])
    return [
        _table(setting, by_label, reference or default_reference(by_label))
        for setting, by_label in tables.items()
    ]


def compare_folders(folders: Sequence[str | Path], reference: str | None = None) -> ComparisonTable:
    """Compare all evaluations in some folders in one table, across simulators.

    Args:
        folders: Folders, searched recursively.
        reference: Label of the policy that the others are compared with; the first if ``None``.

    Raises:
        ValueError: If they did not play the same episodes, or the reference does not exist.
    """
    evaluations = find_evaluations(folders)
    check_same_episodes(evaluations)
    simulators = sorted({evaluation.setting[2] for evaluation in evaluations})
    perturbations = {evaluation.perturbation for evaluation in evaluations}
    differs = len(perturbations) > 1
    by_label = _labelled(evaluations, len(simulators) > 1, with_perturbation=differs)
    if reference is None:
        reference = next(iter(by_label))
    check_reference(reference, by_label)
    suite, suite_hash, _ = evaluations[0].setting
    suite = str(evaluations[0].summary["suite"]) if differs else suite
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
    setting: tuple[str, str, str], by_label: Mapping[str, Evaluation], reference: str | None
) -> ComparisonTable:
    # An equal hash means the same episodes.
    is_frozen = any(evaluation.is_frozen for evaluation in by_label.values())
    published = published_figures().get(setting[0], {}) if is_frozen else {}
    finished = finished_by_all(list(by_label.values()))
    rows = []
    for label, evaluation in by_label.items():
        other = by_label.get(reference_of(label, reference, by_label))
        if other is evaluation:
            other = None
        rows.append(_row(label, evaluation, other, finished, published))
    tested = [row for row in rows if row.p_value is not None]
    corrected = dict(zip(map(id, tested), holm([row.p_value for row in tested]), strict=True))
    rows = [replace(row, p_holm=corrected.get(id(row))) for row in rows]
    rows.sort(key=lambda row: (-row.rates["success"], row.policy))
    has_reference = any(row.difference is not None for row in rows) or reference in by_label
    return ComparisonTable(
        *setting,
        is_frozen=is_frozen,
        reference=reference if has_reference else None,
        rows=rows,
        finished_by_all=len(finished),
        seeds=over_seeds(by_label),
        lead=_lead(rows, by_label),
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
    if not any(evaluation.success.values()):
        finished = set()  # its times end with collisions
    difference = interval = p_value = None
    if reference is not None:
        found, p_value = success_difference(evaluation, reference)
        difference, interval = found.value, (found.low, found.high)
    metrics = compare_metrics(evaluation, reference, finished)
    intervals = {name: wilson_interval(counts[name], total) for name in _RATES}
    for name, own in ((m.name, m.own) for m in metrics if m.name in COLLISIONS):
        rates[name], intervals[name] = own.value, (own.low, own.high)
    times = evaluation.finite("time_s")
    return ComparisonRow(
        policy=label,
        episodes=total,
        errors=int(summary.get("errors", 0)),
        rates=rates,
        intervals=intervals,
        time_s=summary.get("navigation_time_s"),
        common_time=bootstrap_mean([times[index] for index in sorted(finished)]),
        difference=difference,
        difference_interval=interval,
        p_value=p_value,
        p_holm=None,  # computed for the whole table
        metrics=metrics,
        published=published.get(split_seed(label)[0], {}),
        is_privileged=is_privileged(evaluation),
        folder=str(evaluation.folder),
        observes=tuple(summary.get("observes", ())),
    )


_PLACES = (lambda e: e.folder.name, lambda e: e.folder.parent.name, lambda e: str(e.folder))


def _labelled(
    evaluations: Sequence[Evaluation], with_simulator: bool = False, with_perturbation: bool = False
) -> dict[str, Evaluation]:
    """Return unique labels of evaluations, with their folders where names coincide."""
    groups: dict[str, list[Evaluation]] = {}
    for evaluation in evaluations:
        label = evaluation.label
        if with_perturbation and evaluation.perturbation is not None:
            label += f" under {evaluation.perturbation}"
        if with_simulator:
            label += f", {evaluation.setting[2]}"
        groups.setdefault(label, []).append(evaluation)
    labels = {}
    for label, members in groups.items():
        if len(members) == 1:
            labels[id(members[0])] = label
            continue
        places = [[place(member) for member in members] for place in _PLACES]
        unique = next((names for names in places if len({*names}) == len(names)), places[-1])
        for member, name in zip(members, unique, strict=True):
            labels[id(member)] = f"{label} ({name})"
    return {labels[id(evaluation)]: evaluation for evaluation in evaluations}


def _lead(rows: Sequence[ComparisonRow], by_label: Mapping[str, Evaluation]) -> Lead | None:
    """Compare the first non-privileged one of sorted rows with the next of another approach."""
    fair = [row.policy for row in rows if not row.is_privileged]
    others = [name for name in fair if split_seed(name)[0] != split_seed(fair[0])[0]]
    if not others:
        return None
    found, p_value = success_difference(by_label[fair[0]], by_label[others[0]])
    return Lead(fair[0], others[0], found.value, (found.low, found.high), p_value)
