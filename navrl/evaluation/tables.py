"""Comparisons as Markdown for people, CSV for spreadsheets and JSON for programs."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict
from io import StringIO
from pathlib import Path

from navrl.evaluation.comparison import ComparisonRow, ComparisonTable

NAME = "comparison"
"""Of the three files."""

_RATES = ("success", "collision", "timeout")
_NOTHING = "\N{EN DASH}"


def write_comparison(tables: Sequence[ComparisonTable], folder: Path) -> list[Path]:
    """Write ``comparison.md``, ``comparison.csv`` and ``comparison.json``; return the files."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        ".md": "\n".join(markdown(table) for table in tables),
        ".csv": comma_separated(tables),
        ".json": json.dumps([_plain(table) for table in tables], indent=2) + "\n",
    }
    files = [folder / f"{NAME}{suffix}" for suffix in texts]
    for file, text in zip(files, texts.values(), strict=True):
        file.write_text(text, encoding="utf-8")
    return files


def _plain(table: ComparisonTable) -> dict:
    """Return a table as plain data, the difference in time under names of its own."""
    plain = asdict(table)
    for row, stored in zip(table.rows, plain["rows"], strict=True):
        stored["time_difference"] = row.time_difference and row.time_difference._asdict()
    return plain


def markdown(table: ComparisonTable) -> str:
    """Return a table with all that is needed to judge it: sample sizes, intervals and the hash."""
    reference = table.reference
    header = ["policy", "n", *_RATES, "time of successes"]
    if reference:
        header += [f"success vs `{reference}`", "p (McNemar)", f"time vs `{reference}`"]
    has_published = any(row.published for row in table.rows)
    if has_published:
        header += ["the paper's own success / collision / timeout / time"]
    lines = [
        f"### {table.suite}, {table.simulator}",
        "",
        f"Episodes: hash `{table.suite_hash}`. Rates with 95 % Wilson intervals"
        + (f"; differences on the same episodes to `{reference}`." if reference else "."),
        "",
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
    ]
    lines += ["| " + " | ".join(_cells(row, reference, has_published)) + " |" for row in table.rows]
    if any(row.cheats for row in table.rows):
        lines += ["", "\\* reads the true state of walls and pedestrians: no rival, a ceiling."]
    return "\n".join(lines + _seeds(table)) + "\n"


def comma_separated(tables: Sequence[ComparisonTable]) -> str:
    """Return all rows of all tables, a number a cell; an empty cell is not known."""
    rows = [_flat(table, row) for table in tables for row in table.rows]
    text = StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _seeds(table: ComparisonTable) -> list[str]:
    """Return a second table of what several training seeds gave; nothing without any."""
    if not table.seeds:
        return []
    header = ["policy", "seeds", "interquartile mean of success", "worst", "best"]
    lines = ["", "| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    for row in table.seeds:
        low, high = row.interval
        mean = f"{100 * row.success:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"
        ends = f"{100 * row.least:.1f} % | {100 * row.most:.1f} %"
        lines.append(f"| `{row.policy}` | {row.runs} | {mean} | {ends} |")
    note = "Over kinds of worlds and seeds, with 95 % intervals by a stratified bootstrap."
    return [*lines, "", note]


def _cells(row: ComparisonRow, reference: str | None, has_published: bool) -> list[str]:
    errors = f" ({row.errors} errors)" if row.errors else ""
    cells = [f"`{row.policy}`" + ("\\*" if row.cheats else ""), f"{row.episodes:,}{errors}"]
    for name in _RATES:
        low, high = row.intervals[name]
        cells.append(f"{100 * row.rates[name]:.1f} % [{100 * low:.1f}, {100 * high:.1f}]")
    cells.append(_NOTHING if row.time_s is None else f"{row.time_s:.1f} s")
    if reference:
        known = row.difference is not None
        cells.append(f"{100 * row.difference:+.1f} points" if known else _NOTHING)
        cells.append(_p_value(row.p_value) if known else _NOTHING)
        cells.append(_time_difference(row))
    if has_published:
        cells.append(_published(row))
    return cells


def _p_value(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def _time_difference(row: ComparisonRow) -> str:
    if row.time_difference is None:
        return _NOTHING
    value, low, high, _, _ = row.time_difference
    return f"{value:+.1f} s [{low:+.1f}, {high:+.1f}]"


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
    flat |= {"success_difference": row.difference, "p_value": row.p_value}
    time = row.time_difference
    flat |= {
        "time_difference_s": time and time.value,
        "time_low_s": time and time.low,
        "time_high_s": time and time.high,
        "won_by_both": time and time.n,
    }
    for name in (*_RATES, "time"):
        flat[f"paper_{name}"] = row.published.get(name)
    return {name: "" if value is None else value for name, value in flat.items()}
