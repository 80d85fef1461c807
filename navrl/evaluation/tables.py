"""Comparisons as Markdown for people, CSV for spreadsheets and JSON for programs.

The columns and keys are documented in ``docs/evaluation.md``.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from io import StringIO
from pathlib import Path

from navrl.evaluation.comparison import ComparisonRow, ComparisonTable
from navrl.evaluation.pairing import MetricComparison
from navrl.evaluation.statistics import Estimate

NAME = "comparison"
"""Of the files."""

_RATES = ("success", "collision", "timeout")
_NOTHING = "\N{EN DASH}"


def write_comparison(tables: Sequence[ComparisonTable], folder: Path) -> list[Path]:
    """Write the tables into ``folder``.

    Returns:
        ``comparison.md``, ``comparison.csv`` (a row a policy), ``comparison.json`` (everything) and
        ``comparison_metrics.csv`` (a row for each policy and metric).
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        ".md": "\n".join(markdown(table) for table in tables),
        ".csv": comma_separated(tables),
        ".json": json.dumps([_plain(asdict(t)) for t in tables], indent=2, allow_nan=False) + "\n",
        "_metrics.csv": metrics_comma_separated(tables),
    }
    files = [folder / f"{NAME}{suffix}" for suffix in texts]
    for file, text in zip(files, texts.values(), strict=True):
        file.write_text(text, encoding="utf-8")
    return files


def markdown(table: ComparisonTable) -> str:
    """Return a table with all that is needed to judge it: sample sizes, intervals and the hash."""
    reference = table.reference
    header = ["policy", "n", *_RATES, "time of successes"]
    header += [f"time where all succeed, n={table.finished_by_all}"]
    if reference:
        header += [f"success vs `{reference}`", "p (McNemar)"]
    has_published = any(row.published for row in table.rows)
    if has_published:
        header += ["the paper's own success / collision / timeout / time"]
    lines = [
        f"### {table.suite}, {table.simulator}",
        "",
        f"Episodes: hash `{table.suite_hash}`. Rates with 95 % Wilson intervals"
        + (
            f"; differences on the same episodes, in points, to `{reference}`."
            if reference
            else "."
        ),
        "",
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
    ]
    lines += ["| " + " | ".join(_cells(row, reference, has_published)) + " |" for row in table.rows]
    if any(row.cheats for row in table.rows):
        lines += ["", "\\* reads the true state of walls and pedestrians: no rival, a ceiling."]
    return "\n".join([*lines, *_seed_lines(table)]) + "\n"


def metrics_markdown(table: ComparisonTable, names: Sequence[str] = ()) -> str:
    """Return the other metrics, a row for each metric and policy.

    Args:
        table: Of one suite.
        names: Which metrics; all if empty.
    """
    reference = table.reference
    header = ["metric", "policy", "mean", "n", "mean where all succeed", "n"]
    header += [f"vs `{reference}`", "pairs", "p (bootstrap)"] if reference else []
    lines = [
        f"#### Metrics on {table.suite}, {table.simulator}",
        "",
        "Means with 95 % bootstrap intervals. What grows with an episode's length is taken over "
        "successes, the rest over all episodes; differences over the episodes where both have it.",
        "",
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
    ]
    known = dict.fromkeys(metric.name for row in table.rows for metric in row.metrics)
    for name in names or known:
        for row in table.rows:
            found = [metric for metric in row.metrics if metric.name == name]
            lines += ["| " + " | ".join(_metric_cells(row, m, reference)) + " |" for m in found]
    return "\n".join(lines) + "\n"


def comma_separated(tables: Sequence[ComparisonTable]) -> str:
    """Return all rows of all tables, a number a cell; an empty cell is not known."""
    return _csv([_flat(table, row) for table in tables for row in table.rows])


def metrics_comma_separated(tables: Sequence[ComparisonTable]) -> str:
    """Return all metrics of all rows of all tables; an empty cell is not known."""
    return _csv(
        [
            _flat_metric(table, row, metric)
            for table in tables
            for row in table.rows
            for metric in row.metrics
        ]
    )


def _csv(rows: Sequence[Mapping[str, object]]) -> str:
    text = StringIO(newline="")
    if rows:
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: "" if _is_nothing(v) else v for k, v in row.items()} for row in rows)
    return text.getvalue()


def _seed_lines(table: ComparisonTable) -> list[str]:
    if not table.seeds:
        return []
    lines = [
        "",
        "Over training seeds: interquartile mean of the success rates in all kinds of worlds, 95 % "
        "stratified bootstrap interval.",
        "",
        "| approach | seeds | success | lowest to highest seed | episodes each |",
        "|---|---|---|---|---|",
    ]
    for item in table.seeds:
        worst, best = 100 * min(item.rates), 100 * max(item.rates)
        lines.append(
            f"| `{item.approach}` | {item.success.n} | {_percent(item.success)} | "
            f"{worst:.1f} to {best:.1f} % | {item.episodes:,} |"
        )
    return lines


def _percent(estimate: Estimate) -> str:
    value, low, high = (100 * number for number in estimate[:3])
    return f"{value:.1f} % [{low:.1f}, {high:.1f}]"


def _metric_cells(row: ComparisonRow, metric: MetricComparison, reference: str | None) -> list[str]:
    own, common, difference = metric.own, metric.common, metric.difference
    unit = "" if metric.unit == "1" else f" {metric.unit}"
    cells = [f"`{metric.name}`", f"`{row.policy}`"]
    for estimate in (own, common):
        value, low, high, count = estimate
        cells += [f"{value:.3g}{unit} [{low:.3g}, {high:.3g}]" if count else _NOTHING, f"{count:,}"]
    if reference and (difference is None or not difference.n):
        cells += [_NOTHING] * 3
    elif reference:
        value, low, high, p_value, pairs = difference
        cells += [f"{value:+.3g} [{low:+.3g}, {high:+.3g}]", f"{pairs:,}", _p_value(p_value)]
    return cells


def _cells(row: ComparisonRow, reference: str | None, has_published: bool) -> list[str]:
    errors = f" ({row.errors} errors)" if row.errors else ""
    cells = [f"`{row.policy}`" + ("\\*" if row.cheats else ""), f"{row.episodes:,}{errors}"]
    for name in _RATES:
        low, high = row.intervals[name]
        cells.append(f"{100 * row.rates[name]:.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    cells.append(_NOTHING if row.time_s is None else f"{row.time_s:.1f} s")
    time = row.common_time
    cells.append(f"{time.value:.1f} s [{time.low:.1f}, {time.high:.1f}]" if time.n else _NOTHING)
    if reference:
        known = row.difference is not None
        cells.append(_points(row) if known else _NOTHING)
        cells.append(_p_value(row.p_value) if known else _NOTHING)
    if has_published:
        cells.append(_published(row))
    return cells


def _points(row: ComparisonRow) -> str:
    low, high = row.difference_interval
    return f"{100 * row.difference:+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]"


def _p_value(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _published(row: ComparisonRow) -> str:
    if not row.published:
        return _NOTHING
    cells = [
        f"{100 * row.published[name]:.1f} %" if name in row.published else _NOTHING
        for name in _RATES
    ]
    time = row.published.get("time")
    return " / ".join([*cells, _NOTHING if time is None else f"{time:.1f} s"])


def _flat(table: ComparisonTable, row: ComparisonRow) -> dict[str, object]:
    flat: dict[str, object] = {
        "suite": table.suite,
        "suite_hash": table.suite_hash,
        "simulator": table.simulator,
        "policy": row.policy,
        "cheats": int(row.cheats),
        "episodes": row.episodes,
        "errors": row.errors,
    }
    for name in _RATES:
        low, high = row.intervals[name]
        flat |= {f"{name}_rate": row.rates[name], f"{name}_low": low, f"{name}_high": high}
    flat |= {"navigation_time_s": row.time_s, "reference": table.reference}
    low, high = row.difference_interval or (None, None)
    flat |= {"success_difference": row.difference, "p_value": row.p_value}
    for name in (*_RATES, "time"):
        flat[f"paper_{name}"] = row.published.get(name)
    flat |= {"success_difference_low": low, "success_difference_high": high}
    return flat | _numbered("common_time_s", row.common_time)


def _flat_metric(
    table: ComparisonTable, row: ComparisonRow, metric: MetricComparison
) -> dict[str, object]:
    flat: dict[str, object] = {
        "suite": table.suite,
        "suite_hash": table.suite_hash,
        "simulator": table.simulator,
        "policy": row.policy,
        "metric": metric.name,
        "unit": metric.unit,
        "over": metric.over,
    }
    flat |= _numbered("mean", metric.own) | _numbered("common", metric.common)
    value, low, high, p_value, pairs = metric.difference or (None,) * 5
    flat |= {"reference": table.reference, "difference": value, "difference_low": low}
    return flat | {"difference_high": high, "p_value": p_value, "pairs": pairs}


def _numbered(name: str, estimate: Estimate) -> dict[str, float]:
    values = dict(zip(("", "_low", "_high", "_n"), estimate, strict=True))
    return {f"{name}{suffix}": value for suffix, value in values.items()}


def _plain(value: object) -> object:
    """Return JSON's own types; estimates by the names of their parts, what is not known as null."""
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if _is_nothing(value) else value


def _is_nothing(value: object) -> bool:
    return value is None or (isinstance(value, float) and not math.isfinite(value))
