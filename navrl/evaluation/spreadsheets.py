"""Comparisons as CSV files, one value per cell.

The columns are documented in ``docs/evaluation.md``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from navrl.evaluation.comparison import ComparisonRow, ComparisonTable
from navrl.evaluation.pairing import COLLISIONS, MetricComparison
from navrl.evaluation.seeds import OverSeeds, SeedSummary
from navrl.evaluation.statistics import Estimate
from navrl.files import csv_text

_RATES = ("success", "collision", "timeout")


def comma_separated(tables: Sequence[ComparisonTable]) -> str:
    """Return all rows of all tables as CSV; unknown values are empty cells."""
    return _csv([_flat(table, row) for table in tables for row in table.rows])


def metrics_comma_separated(tables: Sequence[ComparisonTable]) -> str:
    """Return all metrics of all rows of all tables as CSV; unknown values are empty cells."""
    return _csv(
        [
            _flat_metric(table, row, metric)
            for table in tables
            for row in table.rows
            for metric in row.metrics
        ]
    )


def seeds_comma_separated(tables: Sequence[ComparisonTable]) -> str:
    """Return summaries over training seeds as CSV, one row per approach and value."""
    return _csv(
        [
            _flat_seeds(table, summary, found)
            for table in tables
            for summary in table.seeds
            for found in summary.metrics
        ]
    )


def is_unknown(value: object) -> bool:
    """Return whether a value is unknown."""
    return value is None or (isinstance(value, float) and not math.isfinite(value))


def _csv(rows: Sequence[Mapping[str, object]]) -> str:
    known = ({k: None if is_unknown(v) else v for k, v in row.items()} for row in rows)
    return csv_text(list(rows[0]), known) if rows else ""


def _flat(table: ComparisonTable, row: ComparisonRow) -> dict[str, object]:
    flat: dict[str, object] = {
        "suite": table.suite,
        "suite_hash": table.suite_hash,
        "simulator": table.simulator,
        "policy": row.policy,
        "privileged": int(row.is_privileged),
        "observes": ", ".join(row.observes),
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
    flat |= _numbered("common_time_s", row.common_time)
    for name in COLLISIONS:
        low, high = row.intervals.get(name, (None, None))
        flat |= {f"{name}_rate": row.rates.get(name), f"{name}_low": low, f"{name}_high": high}
    return flat | {"p_holm": row.p_holm, "frozen": int(table.is_frozen)}


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


def _flat_seeds(
    table: ComparisonTable, summary: SeedSummary, found: OverSeeds
) -> dict[str, object]:
    value, low, high, count = found.estimate
    return {
        "suite": table.suite,
        "suite_hash": table.suite_hash,
        "simulator": table.simulator,
        "approach": summary.approach,
        "metric": found.name,
        "unit": found.unit,
        "seeds": count,
        "iqm": value,
        "iqm_low": low,
        "iqm_high": high,
        "worst": found.worst,
        "best": found.best,
        "episodes": summary.episodes,
    }


def _numbered(name: str, estimate: Estimate) -> dict[str, float]:
    values = dict(zip(("", "_low", "_high", "_n"), estimate, strict=True))
    return {f"{name}{suffix}": value for suffix, value in values.items()}
