"""Success of policies under named perturbations: one row each, beside the unperturbed run."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from navrl.evaluation.pairing import success_difference
from navrl.evaluation.reference import is_privileged
from navrl.evaluation.statistics import holm, wilson_interval
from navrl.evaluation.stored import Evaluation
from navrl.files import markdown_text, write_text

NAME = "robustness"
"""Name of the files without suffix."""

NOMINAL = "nominal"
"""Name of the perturbation that the others are compared with."""

KINDS = (NOMINAL, "time", "base", "lidar", "localization", "robot", "scanner")
"""Kinds of perturbations in the order of the rows; others follow."""

_COLUMNS = (
    *("suite", "suite_hash", "simulator", "perturbation", "kind", "about", "policy", "episodes"),
    *("success_rate", "low", "high", "difference", "p_value", "p_holm"),
)
_ALPHA = 0.05  # level of the mark beside a rate


@dataclass(frozen=True)
class PerturbedRate:
    """Success of one policy under one perturbation.

    Args:
        rate: Success rate in [0, 1].
        interval: Its 95 % Wilson interval.
        episodes: Number of episodes.
        difference: Rate minus that of the same policy in the nominal run, on the same episodes;
            ``None`` without that run and for itself.
        p_value: Exact McNemar test of the difference; ``None`` likewise and for fewer than 6
            episodes.
        p_holm: The same with Holm's correction for the tests of the policy.
        folder: Folder of the evaluation.
    """

    rate: float
    interval: tuple[float, float]
    episodes: int
    difference: float | None
    p_value: float | None
    p_holm: float | None
    folder: str


@dataclass(frozen=True)
class RobustnessRow:
    """Row of a table: one perturbation.

    Args:
        name: Name of the perturbation.
        kind: Kind of it, one of :data:`KINDS` or another text.
        about: What is perturbed, and by how much.
        rates: Success by policy; policies that did not play it are missing.
    """

    name: str
    kind: str
    about: str
    rates: Mapping[str, PerturbedRate]


@dataclass(frozen=True)
class RobustnessTable:
    """Success of policies under perturbations, on the same episodes and simulator.

    Args:
        suite: Name of the suite.
        suite_hash: Hash of its episodes.
        simulator: Name of the simulator.
        policies: Labels, the privileged ones last.
        privileged: Labels of the policies that read the true state.
        rows: One row per perturbation.
    """

    suite: str
    suite_hash: str
    simulator: str
    policies: Sequence[str]
    privileged: frozenset[str]
    rows: Sequence[RobustnessRow]


def robustness_tables(evaluations: Sequence[Evaluation]) -> list[RobustnessTable]:
    """Return a table for each suite, hash of episodes and simulator that has perturbed runs.

    Args:
        evaluations: Evaluations; those without perturbation are skipped. If a policy played a
            perturbation several times, the last one counts.
    """
    groups: dict[tuple[str, str, str], list[Evaluation]] = {}
    for evaluation in evaluations:
        if evaluation.perturbation is not None:
            known = evaluation.summary
            setting = (str(known["suite"]), str(known["suite_hash"]), str(known["simulator"]))
            groups.setdefault(setting, []).append(evaluation)
    return [_table(setting, members) for setting, members in groups.items()]


def _table(setting: tuple[str, str, str], members: Sequence[Evaluation]) -> RobustnessTable:
    privileged = frozenset(e.label for e in members if is_privileged(e))
    policies = sorted({e.label for e in members}, key=lambda label: (label in privileged, label))
    rates = {policy: _rates([e for e in members if e.label == policy]) for policy in policies}
    facts = {str(e.perturbation): e.summary["perturbation"] for e in members}
    rows = [
        RobustnessRow(
            name,
            str(fact["kind"]),
            str(fact["about"]),
            {policy: rates[policy][name] for policy in policies if name in rates[policy]},
        )
        for name, fact in facts.items()
    ]
    rows.sort(key=lambda row: (_place(row.kind), row.kind, row.name))
    return RobustnessTable(*setting, policies, privileged, rows)


def _place(kind: str) -> int:
    return KINDS.index(kind) if kind in KINDS else len(KINDS)


def _rates(evaluations: Sequence[Evaluation]) -> dict[str, PerturbedRate]:
    """Return the success of one policy by perturbation."""
    by_name = {str(e.perturbation): e for e in evaluations}
    reference = by_name.get(NOMINAL)
    tests: dict[str, tuple[float, float | None]] = {}
    for name, evaluation in by_name.items():
        if reference is not None and evaluation is not reference:
            found, p_value = success_difference(evaluation, reference)
            tests[name] = found.value, p_value
    tested = {name: p for name, (_, p) in tests.items() if p is not None}
    corrected = dict(zip(tested, holm(list(tested.values())), strict=True))
    return {
        name: _rate(evaluation, *tests.get(name, (None, None)), corrected.get(name))
        for name, evaluation in by_name.items()
    }


def _rate(
    evaluation: Evaluation, difference: float | None, p_value: float | None, p_holm: float | None
) -> PerturbedRate:
    total = int(evaluation.summary["episodes"])
    successes = round(float(evaluation.summary["success_rate"]) * total)
    return PerturbedRate(
        successes / total,
        wilson_interval(successes, total),
        total,
        difference,
        p_value,
        p_holm,
        str(evaluation.folder),
    )


def robustness_markdown(table: RobustnessTable) -> str:
    """Return a table in Markdown: perturbations as rows, policies as columns."""
    labels = [
        f"`{markdown_text(policy, code=True)}`" + ("\\*" if policy in table.privileged else "")
        for policy in table.policies
    ]
    lines = [
        f"### Robustness on {markdown_text(table.suite)}, {markdown_text(table.simulator)}",
        "",
        f"Episodes: hash `{markdown_text(table.suite_hash, code=True)}`. Success in % with 95 % "
        f"Wilson interval. ~: not different from the same policy's run `{NOMINAL}` on the same "
        f"episodes (exact McNemar test, Holm's correction for the policy's tests, p >= {_ALPHA}).",
        "",
        "| | perturbation | " + " | ".join(labels) + " |",
        "|" + "---|" * (len(labels) + 2),
    ]
    for row in table.rows:
        cells = [_cell(row.rates.get(policy)) for policy in table.policies]
        name = f"`{markdown_text(row.name, code=True)}`"
        lines.append(f"| {name} | {markdown_text(row.about)} | " + " | ".join(cells) + " |")
    if table.privileged:
        lines += [
            "",
            "\\* privileged: reads the true state. The oracle plans under the same limits, so its "
            "success is a lower bound of what is possible.",
        ]
    return "\n".join(lines) + "\n"


def _cell(found: PerturbedRate | None) -> str:
    if found is None:
        return "\N{EN DASH}"
    low, high = (100 * end for end in found.interval)
    mark = "~" if found.p_holm is not None and found.p_holm >= _ALPHA else ""
    return f"{100 * found.rate:.1f}{mark} [{low:.1f}, {high:.1f}]"


def write_robustness(tables: Sequence[RobustnessTable], folder: Path) -> list[Path]:
    """Write ``robustness.md`` and ``robustness.csv``, one row per perturbation and policy.

    Returns:
        Paths of the files.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_COLUMNS])
    for table in tables:
        for row in table.rows:
            for policy, found in row.rates.items():
                numbers = (found.difference, found.p_value, found.p_holm)
                writer.writerow(
                    [table.suite, table.suite_hash, table.simulator, row.name, row.kind, row.about]
                    + [policy, found.episodes, found.rate, *found.interval]
                    + ["" if number is None else number for number in numbers]
                )
    files = [folder / f"{NAME}{suffix}" for suffix in (".md", ".csv")]
    write_text(files[0], "\n".join(robustness_markdown(table) for table in tables))
    write_text(files[1], text.getvalue())
    return files
