"""Tables of the report, sortable by the values of their cells."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

from navrl.evaluation.comparison import ComparisonRow, ComparisonTable
from navrl.evaluation.observed import observed_text
from navrl.evaluation.pairing import MetricComparison
from navrl.evaluation.statistics import (
    MIN_PAIRS,
    MIN_SEEDS,
    Estimate,
    PairedDifference,
    interval_text,
    p_value_text,
)
from navrl.evaluation.stored import Evaluation
from navrl.viz.report.endings import ENDINGS, ending_of_row
from navrl.viz.report.verdict import members

_RATES = ("success", "collision", "timeout")


def comparison_table(table: ComparisonTable) -> str:
    """Return the table of policies, one row each, sortable by a click on a heading."""
    header = ["policy", "episodes", *_RATES, "time of successes, s"]
    header += [f"time where all succeed, s (n={table.finished_by_all})"]
    if table.reference:
        header += [f"success vs {table.reference}, points", "p (McNemar, Holm)"]
    published = any(row.published for row in table.rows)
    if published:
        header += ["paper's own success", "paper's own time, s"]
    body = "".join(_row(row, bool(table.reference), published) for row in table.rows)
    notes = [observed_text(table.rows, escape)]
    if any(row.is_privileged for row in table.rows):
        notes.insert(0, "* privileged: reads the true state of walls and pedestrians.")
    return _sortable(header, body) + "".join(f"<p>{note}</p>" for note in notes if note)


def _sortable(header: Sequence[str], body: str, num_words: int = 1) -> str:
    """Return a table with ``num_words`` columns of text, followed by columns of numbers."""
    looks = [' class="words"' * (i < num_words) for i in range(len(header))]
    head = "".join(
        f'<th scope="col"{look}><button>{escape(name)}</button></th>'
        for name, look in zip(header, looks, strict=True)
    )
    return (
        '<div class="wide"><table class="sortable">'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>\n"
    )


def _row(row: ComparisonRow, has_reference: bool, has_published: bool) -> str:
    cells = [f'<th scope="row">{escape(row.policy)}{"*" if row.is_privileged else ""}</th>']
    cells.append(
        _cell(row.episodes, f"{row.episodes:,}" + (f", {row.errors} errors" * bool(row.errors)))
    )
    for name in _RATES:
        low, high = (100 * bound for bound in row.intervals[name])
        span = f"{100 * row.rates[name]:.1f} %{_interval(low, high, '.1f')}"
        cells.append(_cell(row.rates[name], span))
    cells.append(_cell(row.time_s, f"{row.time_s or 0:.1f}"))
    value, low, high, count = row.common_time
    span = f"{value:.1f}{_interval(low, high, '.1f')}"
    cells.append(_cell(value if count else None, span))
    if has_reference:
        cells.append(_cell(row.difference, _points(row)))
        cells.append(_cell(row.p_holm, escape(p_value_text(row.p_holm))))
    if has_published:
        success, time = row.published.get("success"), row.published.get("time")
        cells += [_cell(success, f"{100 * (success or 0):.1f} %"), _cell(time, f"{time or 0:.1f}")]
    return f"<tr>{''.join(cells)}</tr>"


def _points(row: ComparisonRow) -> str:
    if row.difference is None:
        return ""
    low, high = (100 * bound for bound in row.difference_interval)
    return f"{100 * row.difference:+.1f}{_interval(low, high, '+.1f')}"


def _interval(low: float, high: float, form: str) -> str:
    text = interval_text(low, high, form).strip()
    return f" <small>{text}</small>" if text else ""


def _cell(value: float | None, shown: str) -> str:
    """Return a cell that is sorted by its value; unknown values are last."""
    return (
        '<td data-value="">\N{EN DASH}</td>'
        if value is None
        else f'<td data-value="{value}">{shown}</td>'
    )


def seeds_table(table: ComparisonTable) -> str:
    """Return the summaries over training seeds; empty without any."""
    if not table.seeds:
        return ""
    header = ["approach", "seeds", "success over seeds", "worst", "best"]
    rows = []
    for item in table.seeds:
        value, low, high, runs = item.success
        span = f"{100 * value:.1f} %{_interval(100 * low, 100 * high, '.1f')}"
        ends = min(item.rates), max(item.rates)
        worst_best = "".join(_cell(rate, f"{100 * rate:.1f} %") for rate in ends)
        name = f'<th scope="row">{escape(item.approach)}</th>'
        rows.append(f"<tr>{name}{_cell(runs, str(runs))}{_cell(value, span)}{worst_best}</tr>")
    note = (
        "Over training seeds: interquartile mean over seeds and kinds of worlds, 95 % bootstrap "
        f"interval from {MIN_SEEDS} seeds on."
    )
    return f"<p>{note}</p>{_sortable(header, ''.join(rows))}"


def measures_table(table: ComparisonTable) -> str:
    """Return the collapsed table of all other metrics; empty if there are none."""
    names = dict.fromkeys(metric.name for row in table.rows for metric in row.metrics)
    if not names:
        return ""
    header = ["measure", "better", "policy", "mean", "n"]
    header += [f"mean over {table.finished_by_all:,} episodes where all succeed", "n of these"]
    if table.reference:
        header += [f"difference to {table.reference}", "pairs", "p"]
    found = [
        (row, m) for name in names for row in table.rows for m in row.metrics if m.name == name
    ]
    body = "".join(_measure_row(row, metric, bool(table.reference)) for row, metric in found)
    errors = ", ".join(f"{row.policy} {row.errors:,}" for row in table.rows if row.errors)
    title = "All measures" + f"; episodes that raised an error: {errors}" * bool(errors)
    note = (
        f"Means with 95 % intervals, from {MIN_PAIRS} values on. What grows with an episode's "
        "length (time, path, turning, standing still) is taken over successes: an episode that "
        "ends early in a collision has no short path. "
        "Means of two policies are comparable only over the episodes where all succeed; "
        "differences are over the episodes where both have the measure, p by sign flips."
    )
    return (
        f'<details class="measures"><summary>{escape(title)}</summary>\n<p>{note}</p>'
        f"{_sortable(header, body, num_words=3)}</details>\n"
    )


def _measure_row(row: ComparisonRow, metric: MetricComparison, has_reference: bool) -> str:
    cells = [f'<th scope="row">{escape(metric.name)}</th>']
    cells += _words(metric.better, row.policy + "*" * row.is_privileged)
    for estimate, over in ((metric.own, f" {metric.over}"), (metric.common, "")):
        cells += [_estimate_cell(estimate, ""), _cell(estimate.n, f"{estimate.n:,}{over}")]
    difference = metric.difference
    if has_reference and (difference is None or not difference.n):
        cells += [_cell(None, "")] * 3
    elif has_reference:
        cells += [_estimate_cell(difference, "+"), _cell(difference.n, f"{difference.n:,}")]
        p_value = None if math.isnan(difference.p_value) else difference.p_value
        cells.append(_cell(p_value, escape(p_value_text(p_value))))
    return f"<tr>{''.join(cells)}</tr>"


def _words(*texts: str) -> list[str]:
    return [f'<td class="words">{escape(text)}</td>' for text in texts]


def _estimate_cell(estimate: Estimate | PairedDifference, sign: str) -> str:
    form = f"{sign}.3g"
    span = f"{estimate.value:{form}}{_interval(estimate.low, estimate.high, form)}"
    return _cell(estimate.value if estimate.n else None, span)


def episodes_table(
    table: ComparisonTable,
    evaluations: Sequence[Evaluation],
    players: Mapping[tuple[str, int], int],
) -> str:
    """Return a row for each episode of the player, opened by a click; empty without any.

    Args:
        table: Table of one suite.
        evaluations: Evaluations, including those of the table.
        players: Index of a recording in the player, by the evaluation's folder and the episode's
            index.
    """
    rows = []
    for row, evaluation in zip(table.rows, members(table, evaluations), strict=True):
        for index, cells in evaluation.episodes.items():
            player = players.get((row.folder, index))
            if player is not None:
                rows.append((player, _episode_row(row.policy, index, cells, player)))
    if not rows:
        return ""
    header = ["episode", "policy", "world", "how it ended", "after, s"]
    header.append("closest to a pedestrian, m")
    body = "".join(text for _, text in sorted(rows))
    note = "Recorded episodes: a click on one opens it in the player below."
    return f"<p>{note}</p>{_sortable(header, body, num_words=4)}"


def _episode_row(policy: str, index: int, row: Mapping[str, str], player: int) -> str:
    ending = ending_of_row(row)
    link = f'<a href="#player">{index}</a>'
    cells = [f'<th scope="row" data-value="{index}">{link}</th>']
    cells += _words(policy, row.get("scenario", ""), ENDINGS.get(ending, (ending,))[0])
    for name, decimals in (("time_s", 1), ("min_pedestrian_distance_m", 2)):
        value = float(row.get(name) or "nan")
        cells.append(_cell(value if math.isfinite(value) else None, f"{value:.{decimals}f}"))
    return f'<tr class="opens" data-episode="{player}">{"".join(cells)}</tr>'
