"""The page's tables: cells carry their values, by which they are sorted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from navrl.evaluation.comparison import ComparisonRow, ComparisonTable, Evaluation

_RATES = ("success", "collision", "timeout")


def comparison_table(table: ComparisonTable) -> str:
    """Return a row a policy, sorted by a click on a heading."""
    header = ["policy", "episodes", *_RATES, "time of successes, s"]
    if table.reference:
        header += [f"success vs {table.reference}, points", "p (McNemar)"]
        header += [f"time vs {table.reference}, s"]
    published = any(row.published for row in table.rows)
    if published:
        header += ["paper's own success", "paper's own time, s"]
    head = "".join(f'<th scope="col"><button>{escape(name)}</button></th>' for name in header)
    body = "".join(_row(row, bool(table.reference), published) for row in table.rows)
    note = "<p>* reads the true state of walls and pedestrians: a ceiling, no rival.</p>"
    return (
        f'<div class="wide"><table class="sortable"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>\n"
        f"{note if any(row.cheats for row in table.rows) else ''}"
    )


def _row(row: ComparisonRow, has_reference: bool, has_published: bool) -> str:
    cells = [f'<th scope="row">{escape(row.policy)}{"*" if row.cheats else ""}</th>']
    cells.append(
        _cell(row.episodes, f"{row.episodes:,}" + (f", {row.errors} errors" * bool(row.errors)))
    )
    for name in _RATES:
        low, high = row.intervals[name]
        span = f"{100 * row.rates[name]:.1f} % <small>[{100 * low:.1f}, {100 * high:.1f}]</small>"
        cells.append(_cell(row.rates[name], span))
    cells.append(_cell(row.time_s, f"{row.time_s or 0:.1f}"))
    if has_reference:
        cells.append(_cell(row.difference, f"{100 * (row.difference or 0):+.1f}"))
        p_value = row.p_value or 0.0
        cells.append(_cell(row.p_value, "&lt; 0.001" if p_value < 0.001 else f"{p_value:.3f}"))
        time = row.time_difference
        cells.append(_cell(time and time.value, _time_span(row)))
    if has_published:
        success, time = row.published.get("success"), row.published.get("time")
        cells += [_cell(success, f"{100 * (success or 0):.1f} %"), _cell(time, f"{time or 0:.1f}")]
    return f"<tr>{''.join(cells)}</tr>"


def _time_span(row: ComparisonRow) -> str:
    if row.time_difference is None:
        return ""
    value, low, high, _, _ = row.time_difference
    return f"{value:+.1f} <small>[{low:+.1f}, {high:+.1f}]</small>"


def _cell(value: float | None, shown: str) -> str:
    """Return a cell that sorts by its value; what is not known comes last."""
    return (
        '<td data-value="">\N{EN DASH}</td>'
        if value is None
        else f'<td data-value="{value}">{shown}</td>'
    )


def measures_table(table: ComparisonTable, evaluations: Sequence[Evaluation]) -> str:
    """Return every other measure, folded away; nothing if the evaluations have none."""
    by_folder = {str(e.folder): e.summary.get("metrics") or {} for e in evaluations}
    measures = [by_folder[row.folder] for row in table.rows]
    names = list(dict.fromkeys(name for measure in measures for name in measure))
    if not names:
        return ""
    header = ["measure", "unit", "better", *(row.policy for row in table.rows)]
    head = "".join(f'<th scope="col"><button>{escape(name)}</button></th>' for name in header)
    body = "".join(
        _measure_row(name, [measure.get(name) for measure in measures]) for name in names
    )
    return (
        "<details><summary>All measures, means over all episodes with 95 % intervals</summary>\n"
        f'<div class="wide"><table class="sortable"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div></details>\n"
    )


def _measure_row(name: str, measures: Sequence[Mapping | None]) -> str:
    known = next(measure for measure in measures if measure)
    cells = [f'<th scope="row">{escape(name)}</th>']
    cells += [f"<td>{escape(str(known.get(key) or ''))}</td>" for key in ("unit", "better")]
    for measure in measures:
        over_all = (measure or {}).get("all") or {}
        cells.append(_cell(over_all.get("mean"), _measured(over_all)))
    return f"<tr>{''.join(cells)}</tr>"


def _measured(values: Mapping) -> str:
    if values.get("mean") is None:
        return ""
    interval = values.get("interval")
    span = f" <small>[{interval[0]:.3g}, {interval[1]:.3g}]</small>" if interval else ""
    return f"{values['mean']:.3g}{span}"
