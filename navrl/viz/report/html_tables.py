"""The page's tables: cells carry their values, by which they are sorted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from navrl.evaluation.comparison import ComparisonRow, ComparisonTable
from navrl.evaluation.stored import Evaluation

_RATES = ("success", "collision", "timeout")


def comparison_table(table: ComparisonTable) -> str:
    """Return a row a policy, sorted by a click on a heading."""
    header = ["policy", "episodes", *_RATES, "time of successes, s"]
    header += [f"time where all succeed, s (n={table.finished_by_all})"]
    if table.reference:
        header += [f"success vs {table.reference}, points", "p (McNemar)"]
    published = any(row.published for row in table.rows)
    if published:
        header += ["paper's own success", "paper's own time, s"]
    head = "".join(f'<th scope="col"><button>{escape(name)}</button></th>' for name in header)
    body = "".join(_row(row, bool(table.reference), published) for row in table.rows)
    note = "<p>* reads the true state of walls and pedestrians: a ceiling, no rival.</p>"
    return _sortable(head, body) + (note if any(row.cheats for row in table.rows) else "")


def _sortable(head: str, body: str) -> str:
    return (
        '<div class="wide"><table class="sortable">'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>\n"
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
    value, low, high, count = row.common_time
    span = f"{value:.1f} <small>[{low:.1f}, {high:.1f}]</small>"
    cells.append(_cell(value if count else None, span))
    if has_reference:
        cells.append(_cell(row.difference, _points(row)))
        p_value = row.p_value or 0.0
        cells.append(_cell(row.p_value, "&lt; 0.001" if p_value < 0.001 else f"{p_value:.3f}"))
    if has_published:
        success, time = row.published.get("success"), row.published.get("time")
        cells += [_cell(success, f"{100 * (success or 0):.1f} %"), _cell(time, f"{time or 0:.1f}")]
    return f"<tr>{''.join(cells)}</tr>"


def _points(row: ComparisonRow) -> str:
    if row.difference is None:
        return ""
    low, high = row.difference_interval
    span = f"<small>[{100 * low:+.1f}, {100 * high:+.1f}]</small>"
    return f"{100 * row.difference:+.1f} {span}"


def _cell(value: float | None, shown: str) -> str:
    """Return a cell that sorts by its value; what is not known comes last."""
    return (
        '<td data-value="">\N{EN DASH}</td>'
        if value is None
        else f'<td data-value="{value}">{shown}</td>'
    )


def seeds_table(table: ComparisonTable) -> str:
    """Return what several trainings of one approach gave; nothing without any."""
    if not table.seeds:
        return ""
    header = ["approach", "seeds", "success over seeds", "worst", "best"]
    head = "".join(f'<th scope="col"><button>{escape(name)}</button></th>' for name in header)
    rows = []
    for item in table.seeds:
        value, low, high, runs = item.success
        span = f"{100 * value:.1f} % <small>[{100 * low:.1f}, {100 * high:.1f}]</small>"
        ends = min(item.rates), max(item.rates)
        worst_best = "".join(_cell(rate, f"{100 * rate:.1f} %") for rate in ends)
        name = f'<th scope="row">{escape(item.approach)}</th>'
        rows.append(f"<tr>{name}{_cell(runs, str(runs))}{_cell(value, span)}{worst_best}</tr>")
    note = "Over training seeds: interquartile mean over seeds and kinds of worlds, 95 % bootstrap."
    return f"<p>{note}</p>{_sortable(head, ''.join(rows))}"


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
    title = "All measures, means over all episodes with 95 % intervals"
    return f"<details><summary>{title}</summary>\n{_sortable(head, body)}</details>\n"


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
