"""Comparisons as Markdown and JSON.

The columns and keys are documented in ``docs/evaluation.md``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from navrl.deprecation import warn
from navrl.evaluation.comparison import ComparisonRow, ComparisonTable
from navrl.evaluation.metrics import METRICS
from navrl.evaluation.metrics.table import RENAMED
from navrl.evaluation.observed import observed_text
from navrl.evaluation.pairing import COLLISIONS, COMPARABLE, MetricComparison
from navrl.evaluation.seeds import OverSeeds
from navrl.evaluation.spreadsheets import (
    comma_separated,
    is_unknown,
    metrics_comma_separated,
    seeds_comma_separated,
)
from navrl.evaluation.statistics import (
    MIN_PAIRS,
    MIN_SEEDS,
    Estimate,
    interval_text,
    p_value_text,
)
from navrl.files import markdown_text, write_text

NAME = "comparison"
"""Name of the files without suffix."""

_RATES = ("success", "collision", "timeout")
_COLLISION_LABELS = [metric.label for metric in METRICS if metric.name in COLLISIONS]
_UNKNOWN = "\N{EN DASH}"


def write_comparison(tables: Sequence[ComparisonTable], folder: Path) -> list[Path]:
    """Write the tables into ``folder``.

    Returns:
        Paths of ``comparison.md``, ``comparison.csv`` (one row per policy), ``comparison.json``
        (all data), ``comparison_metrics.csv`` (one row per policy and metric) and
        ``comparison_seeds.csv``, if an approach was trained with several seeds.
    """
    folder = Path(folder)
    texts = {
        ".md": "\n".join(markdown(table) for table in tables),
        ".csv": comma_separated(tables),
        ".json": json.dumps([_plain(asdict(t)) for t in tables], indent=2, allow_nan=False) + "\n",
        "_metrics.csv": metrics_comma_separated(tables),
        "_seeds.csv": seeds_comma_separated(tables),
    }
    texts = {suffix: text for suffix, text in texts.items() if text or suffix != "_seeds.csv"}
    files = [folder / f"{NAME}{suffix}" for suffix in texts]
    for file, text in zip(files, texts.values(), strict=True):
        write_text(file, text)
    return files


def markdown(table: ComparisonTable) -> str:
    """Return a table in Markdown with sample sizes, intervals and the hash."""
    reference = table.reference
    header = ["policy", "n", *_RATES, "time of successes"]
    header += [f"time where all succeed, n={table.finished_by_all}"]
    if reference:
        header += [f"success vs {_code(reference)}", "p (McNemar, Holm)"]
    has_published = any(row.published for row in table.rows)
    if has_published:
        header += ["the paper's own success / collision / timeout / time"]
    compared = (
        "; differences on the same episodes, in points, to "
        f"{_code(reference or '')}; p corrected by Holm for the number of tests in its column."
    )
    lines = [
        f"### {markdown_text(table.title)}, {markdown_text(table.simulator)}",
        "",
        f"Episodes: hash {_code(table.suite_hash)}. Rates with 95 % Wilson intervals"
        + (compared if reference else "."),
        "",
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
    ]
    lines += ["| " + " | ".join(_cells(row, reference, has_published)) + " |" for row in table.rows]
    if any(row.is_privileged for row in table.rows):
        lines += ["", "\\* privileged: reads the true state of walls and pedestrians."]
    observed = observed_text(table.rows, _code)
    lines += ["", observed] if observed else []
    lines += [*_lead_lines(table), *_collision_lines(table), *_seed_lines(table)]
    return "\n".join(lines) + "\n"


def metrics_markdown(table: ComparisonTable, names: Sequence[str] = ()) -> str:
    """Return the other metrics in Markdown, one row per metric and policy.

    Args:
        table: Table of one suite.
        names: Names of the metrics; all if empty.

    Raises:
        ValueError: If a metric does not exist or is listed twice.
    """
    measured = dict.fromkeys(metric.name for row in table.rows for metric in row.metrics)
    comparable = dict.fromkeys((*COMPARABLE, *measured))
    for old in RENAMED.keys() & set(names):
        warn(f"metrics=[{old}]", f"use {RENAMED[old]}")
    names = [RENAMED.get(name, name) for name in names]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise ValueError(f"metrics={repeated}: must be listed once, under the present name")
    unknown = sorted(set(names) - comparable.keys())
    if unknown:
        raise ValueError(f"metrics={unknown}: must be some of {', '.join(comparable)}")
    reference = table.reference
    header = ["metric", "policy", "mean", "n", "mean where all succeed", "n"]
    header += [f"vs {_code(reference)}", "pairs", "p (sign flips)"] if reference else []
    lines = [
        f"#### Metrics on {markdown_text(table.title)}, {markdown_text(table.simulator)}",
        "",
        "Means with 95 % intervals, of collisions Wilson intervals. What grows with an episode's "
        "length is taken over successes, latencies over decisions, the rest over all episodes; "
        f"differences over the episodes where both have it. Fewer than {MIN_PAIRS} values have "
        "neither interval nor test.",
        "",
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
    ]
    for name in names or measured:
        for row in table.rows:
            found = [metric for metric in row.metrics if metric.name == name]
            lines += ["| " + " | ".join(_metric_cells(row, m, reference)) + " |" for m in found]
    return "\n".join(lines) + "\n"


def _lead_lines(table: ComparisonTable) -> list[str]:
    """Compare the best non-privileged policy with the second best, in a sentence."""
    lead = table.lead
    if lead is None:
        return []
    if lead.is_tie:
        rate = next(row.rates["success"] for row in table.rows if row.policy == lead.best)
        tie = (
            f"{_code(lead.best)} and {_code(lead.second)} tie: "
            f"{100 * rate:.1f} % of the same episodes each."
        )
        return ["", tie]
    points = _points(lead.difference, lead.difference_interval)
    return [
        "",
        f"The best, {_code(lead.best)}, against the next, {_code(lead.second)}, on the same "
        f"episodes: {points} points of success{_test(lead.p_value)}.",
    ]


def _test(p_value: float | None) -> str:
    if p_value is None:
        return f"; no test with fewer than {MIN_PAIRS} episodes"
    text = p_value_text(p_value)
    return f", p {text if text[0] == '<' else f'= {text}'} (McNemar, this test alone)"


def _collision_lines(table: ComparisonTable) -> list[str]:
    if not any(name in row.rates for row in table.rows for name in COLLISIONS):
        return []
    return [
        "",
        "Collisions: what was touched, of people also who moved; shares of all episodes with 95 % "
        "Wilson intervals.",
        "",
        f"| policy | {' | '.join(_COLLISION_LABELS)} |",
        "|---|" + "---|" * len(COLLISIONS),
        *(
            f"| {_code(row.policy)} | {' | '.join(_rate(row, name) for name in COLLISIONS)} |"
            for row in table.rows
        ),
    ]


def _seed_lines(table: ComparisonTable) -> list[str]:
    if not table.seeds:
        return []
    lines = [
        "",
        "Over training seeds: interquartile mean over seeds and kinds of worlds, 95 % stratified "
        f"bootstrap interval from {MIN_SEEDS} seeds on; (worst to best seed). Times are of "
        "successes.",
        "",
        "| approach | seeds | success | collision | time to goal | episodes each |",
        "|---|---|---|---|---|---|",
    ]
    for item in table.seeds:
        cells = " | ".join(_over_seeds(found) for found in item.metrics)
        lines.append(
            f"| {_code(item.approach)} | {len(item.seeds)} | {cells} | {item.episodes:,} |"
        )
    return lines


def _over_seeds(found: OverSeeds) -> str:
    if is_unknown(found.estimate.value):
        return _UNKNOWN
    scale, unit = (100, "%") if found.unit == "1" else (1, found.unit)
    value, low, high, worst, best = (
        scale * number for number in (*found.estimate[:3], found.worst, found.best)
    )
    interval = interval_text(low, high, ".1f")
    return f"{value:.1f} {unit}{interval} ({worst:.1f} to {best:.1f})"


def _percent(estimate: Estimate) -> str:
    value, low, high = (100 * number for number in estimate[:3])
    return f"{value:.1f} % [{low:.1f}, {high:.1f}]"


def _metric_cells(row: ComparisonRow, metric: MetricComparison, reference: str | None) -> list[str]:
    own, common, difference = metric.own, metric.common, metric.difference
    unit = "" if metric.unit == "1" else f" {metric.unit}"
    cells = [f"{_code(metric.name)}", f"{_code(row.policy)}"]
    for estimate in (own, common):
        value, low, high, count = estimate
        interval = interval_text(low, high, ".3g")
        cells += [f"{value:.3g}{unit}{interval}" if count else _UNKNOWN, f"{count:,}"]
    if reference and (difference is None or not difference.n):
        cells += [_UNKNOWN] * 3
    elif reference:
        value, low, high, p_value, pairs = difference
        interval = interval_text(low, high, "+.3g")
        cells += [f"{value:+.3g}{interval}", f"{pairs:,}", p_value_text(p_value)]
    return cells


def _cells(row: ComparisonRow, reference: str | None, has_published: bool) -> list[str]:
    errors = f" ({row.errors} errors)" if row.errors else ""
    cells = [
        f"{_code(row.policy)}" + ("\\*" if row.is_privileged else ""),
        f"{row.episodes:,}{errors}",
    ]
    for name in _RATES:
        cells.append(_rate(row, name))
    cells.append(_UNKNOWN if row.time_s is None else f"{row.time_s:.1f} s")
    time = row.common_time
    interval = interval_text(time.low, time.high, ".1f")
    cells.append(f"{time.value:.1f} s{interval}" if time.n else _UNKNOWN)
    if reference:
        known = row.difference is not None
        cells.append(_points(row.difference, row.difference_interval) if known else _UNKNOWN)
        cells.append(p_value_text(row.p_holm) if known else _UNKNOWN)
    if has_published:
        cells.append(_published(row))
    return cells


def _rate(row: ComparisonRow, name: str) -> str:
    if name not in row.rates:
        return _UNKNOWN
    return _percent(Estimate(row.rates[name], *row.intervals[name], row.episodes))


def _points(difference: float, interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{100 * difference:+.1f}{interval_text(100 * low, 100 * high, '+.1f')}"


def _published(row: ComparisonRow) -> str:
    if not row.published:
        return _UNKNOWN
    cells = [
        f"{100 * row.published[name]:.1f} %" if name in row.published else _UNKNOWN
        for name in _RATES
    ]
    time = row.published.get("time")
    return " / ".join([*cells, _UNKNOWN if time is None else f"{time:.1f} s"])


def _code(name: str) -> str:
    """Return a name as Markdown code, escaped for a table cell."""
    return f"`{markdown_text(name, code=True)}`"


def _plain(value: object) -> object:
    """Convert to JSON types; estimates become objects, unknown values null."""
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if is_unknown(value) else value
