"""Interactive figures of the report."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from navrl.evaluation.comparison import ComparisonTable
from navrl.evaluation.statistics import wilson_interval
from navrl.evaluation.stored import Evaluation
from navrl.viz.curves import TrainingLog
from navrl.viz.rates import (
    RatePoint,
    rate_points,
    rate_rows,
    rated_policies,
    rated_settings,
    rated_worlds,
)
from navrl.viz.report.endings import ENDINGS, ending_of_row
from navrl.viz.report.verdict import members
from navrl.viz.style import BLUE, CYCLE, VERMILLION, line_look

_ROW_PX = 30
_DASHES = {"-": "solid", "--": "dash", "-.": "dashdot", ":": "dot"}  # matplotlib's, as plotly's
_SYMBOLS = ("circle", "square", "diamond", "triangle-up", "triangle-down", "cross", "x", "star")
_PATTERNS = ("", "/", "x", ".")


def success_chart(table: ComparisonTable) -> go.Figure:
    """Draw success with its 95 % interval, and the paper's figure."""
    rows = list(reversed(table.rows))
    names = [literal(row.policy) for row in rows]
    rates = np.array([row.rates["success"] for row in rows])
    low, high = np.array([row.intervals["success"] for row in rows]).T
    texts = [
        f"{literal(row.policy)}: {row.rates['success']:.1%} of {row.episodes:,} [{a:.1%}, {b:.1%}]"
        for row, a, b in zip(rows, low, high, strict=True)
    ]
    error = {"type": "data", "symmetric": False, "array": high - rates, "arrayminus": rates - low}
    look = {"color": BLUE, "size": 9}
    figure = go.Figure(
        go.Scatter(
            x=rates,
            y=names,
            error_x=error,
            mode="markers",
            marker=look,
            name="measured here, 95 % interval",
            hovertext=texts,
            hoverinfo="text",
        )
    )
    published = [(literal(row.policy), row.published["success"]) for row in rows if row.published]
    if published:
        figure.add_scatter(
            x=[rate for _, rate in published],
            y=[name for name, _ in published],
            mode="markers",
            marker={"color": VERMILLION, "size": 10, "symbol": "diamond-open"},
            name="the paper's own figure",
            hovertemplate="%{y}: %{x:.1%} in the paper<extra></extra>",
        )
    figure.update_xaxes(title="success rate", tickformat=".0%", range=[-0.02, 1.02])
    figure.update_yaxes(categoryorder="array", categoryarray=names)
    return _finished(figure, 130 + _ROW_PX * len(names))


def outcome_chart(table: ComparisonTable, evaluations: Sequence[Evaluation]) -> go.Figure:
    """Draw the outcomes of each policy, with collisions by at-fault party and object."""
    figure = go.Figure()
    played = [e.episodes.values() for e in members(table, evaluations)]
    counts = [Counter(map(ending_of_row, rows)) for rows in played]
    names = [literal(row.policy) for row in table.rows]
    for ending, (label, color) in ENDINGS.items():
        values = [count[ending] for count in counts]
        if not any(values):
            continue
        shares = [v / max(sum(c.values()), 1) for v, c in zip(values, counts, strict=True)]
        figure.add_bar(
            x=shares[::-1],
            y=names[::-1],
            orientation="h",
            name=label,
            marker_color=color,
            customdata=values[::-1],
            hovertemplate=f"%{{y}}: {label} in %{{customdata}} (%{{x:.1%}})<extra></extra>",
        )
    figure.update_layout(barmode="stack", legend_traceorder="normal")
    figure.update_xaxes(title="share of episodes", tickformat=".0%", range=[0, 1])
    return _finished(figure, 160 + _ROW_PX * len(names))


def world_chart(table: ComparisonTable, evaluations: Sequence[Evaluation]) -> go.Figure | None:
    """Draw success in each kind of world; ``None`` if there is only one."""
    figure = go.Figure()
    for i, (row, e) in enumerate(zip(table.rows, members(table, evaluations), strict=True)):
        worlds = e.summary.get("by_scenario") or {}
        if len(worlds) < 2:
            continue
        rates = np.array([part["success_rate"] for part in worlds.values()])
        counts = [part["episodes"] for part in worlds.values()]
        won = (round(rate * n) for rate, n in zip(rates, counts, strict=True))
        low, high = np.array(list(map(wilson_interval, won, counts))).T
        name = literal(row.policy)
        figure.add_bar(
            x=list(map(literal, worlds)),
            y=rates,
            name=name,
            marker=_bar_look(i),
            error_y=_error_bars(rates, low, high),
            customdata=counts,
            hovertemplate=f"{name}, %{{x}}: %{{y:.1%}} of %{{customdata}}<extra></extra>",
        )
    if not figure.data:
        return None
    figure.update_yaxes(title="success rate", tickformat=".0%", range=[0, 1.02])
    figure.update_layout(barmode="group")
    return _finished(figure, 380)


def episode_chart(
    table: ComparisonTable,
    evaluations: Sequence[Evaluation],
    players: Mapping[tuple[str, int], int],
) -> go.Figure:
    """Draw the outcome of each episode and policy, one column per episode.

    Args:
        table: Table of one suite.
        evaluations: Evaluations, including those of the table.
        players: Index of a recording in the player, by the evaluation's folder and the episode's
            index; a click on that cell opens it.
    """
    played = [e.episodes for e in members(table, evaluations)]
    indices = sorted(set().union(*played))
    ended = [{i: ending_of_row(row) for i, row in rows.items()} for rows in played]
    shown = [ending for ending in ENDINGS if any(ending in e.values() for e in ended)]
    codes = {ending: code for code, ending in enumerate(shown)}
    colors = [ENDINGS[ending][1] for ending in shown]
    steps = np.repeat(np.linspace(0, 1, len(colors) + 1), 2)[1:-1]
    texts = [
        [_cell_text(literal(row.policy), i, rows.get(i)) for i in indices]
        for row, rows in zip(table.rows, played, strict=True)
    ]
    figure = go.Figure(
        go.Heatmap(
            z=[[codes.get(e.get(i)) for i in indices] for e in ended][::-1],
            x=indices,
            y=[literal(row.policy) for row in table.rows][::-1],
            text=texts[::-1],
            customdata=[[players.get((r.folder, i)) for i in indices] for r in table.rows[::-1]],
            hoverinfo="text",
            zmin=-0.5,
            zmax=len(colors) - 0.5,
            colorscale=[[s, c] for s, c in zip(steps, np.repeat(colors, 2), strict=True)],
            showscale=False,
            ygap=2,
        )
    )
    for ending in shown:
        look = {"color": ENDINGS[ending][1], "size": 12, "symbol": "square"}
        figure.add_scatter(x=[None], y=[None], mode="markers", marker=look, name=ENDINGS[ending][0])
    figure.update_xaxes(title="episode", showgrid=False)
    figure.update_yaxes(showgrid=False)
    return _finished(figure, 160 + _ROW_PX * len(played))


def curves_chart(logs: Sequence[Path]) -> go.Figure:
    """Draw success in the evaluations during training over environment steps."""
    figure = go.Figure()
    looks: dict[str, dict] = {}
    for file in logs:
        name = file.resolve().parent.name
        label = re.sub(r"_seed_\d+", "", name)
        shown = literal(name)
        look = looks.setdefault(label, _look(len(looks)))
        frames, rates = TrainingLog(file).column("evaluation/success_rate")
        figure.add_scatter(
            x=frames,
            y=rates,
            mode="lines+markers",
            name=shown,
            **look,
            hovertemplate=f"{shown}: %{{y:.1%}} after %{{x:,}} steps<extra></extra>",
        )
    figure.update_xaxes(title="environment steps", rangemode="tozero")
    figure.update_yaxes(title="success rate, validation", tickformat=".0%", range=[-0.02, 1.02])
    return _finished(figure, 400, legend=True)


def rates_chart(evaluations: Sequence[Evaluation]) -> go.Figure | None:
    """Draw success over speed and number of pedestrians; ``None`` without a sweep."""
    rows = rate_rows([p for e in evaluations for p in rate_points(e)])
    if not rows or len({str(e.summary["simulator"]) for e in evaluations}) > 1:
        return None
    policies, worlds = rated_policies(rows), rated_worlds(rows)
    figure = make_subplots(
        *(len(rows), len(worlds)),
        shared_yaxes=True,
        subplot_titles=list(map(literal, worlds)) * len(rows),
        horizontal_spacing=0.02,
        vertical_spacing=0.25,
    )
    named: set[str] = set()  # entries of the legend, which all panels share
    for i, (label, lines) in enumerate(rows.items()):
        for j, world in enumerate(worlds):
            at = {"row": i + 1, "col": j + 1}
            for k, policy in enumerate(policies):
                if (policy, world) in lines:
                    trace = _rate_line(lines[policy, world], f"{policy}, {world}", _look(k))
                    trace.update(
                        name=literal(policy), legendgroup=policy, showlegend=policy not in named
                    )
                    figure.add_trace(trace, **at)
                    named.add(policy)
            title = {"text": label, "font": {"size": 11}}
            figure.update_xaxes(title=title, tickvals=rated_settings(lines), **at)
        figure.update_yaxes(title="success rate", row=i + 1, col=1)
    figure.update_yaxes(tickformat=".0%", range=[-0.02, 1.02])
    _finished(figure, 130 + 330 * len(rows), legend=True)
    below = {"y": 0.0, "yref": "container", "yanchor": "bottom"}  # the worlds' names are above
    return figure.update_layout(legend=below, margin_t=60)  # and below the buttons


# --- parts ---------------------------------------------------------------------------------------


def literal(text: str) -> str:
    """Escape a text from a file, so that plotly draws it literally."""
    return escape(text, quote=False).replace("%", "&#37;")


def _look(i: int) -> dict:
    """Return line and marker of the i-th name; equal colors differ in dash and symbol."""
    look = line_look(i)
    return {
        "line": {"color": look["color"], "dash": _DASHES[look["linestyle"]]},
        "marker": {"symbol": _SYMBOLS[i % len(_SYMBOLS)], "size": 7},
    }


def _bar_look(i: int) -> dict:
    """Return the fill of the i-th name's bars; equal colors differ in pattern."""
    pattern = _PATTERNS[i // len(CYCLE) % len(_PATTERNS)]
    return {"color": CYCLE[i % len(CYCLE)], "pattern": {"shape": pattern}}


def _error_bars(rates: np.ndarray, low: np.ndarray, high: np.ndarray) -> dict:
    sides = {"array": high - rates, "arrayminus": rates - low}
    return {"type": "data", "symmetric": False, "thickness": 1, **sides}


def _rate_line(line: Sequence[tuple[float, RatePoint]], name: str, look: dict) -> go.Scatter:
    rates = np.array([point.rate for _, point in line])
    low, high = np.array([point.interval for _, point in line]).T
    return go.Scatter(
        x=[x for x, _ in line],
        y=rates,
        error_y=_error_bars(rates, low, high),
        mode="lines+markers",
        customdata=[point.episodes for _, point in line],
        hovertemplate=f"{literal(name)}: %{{y:.1%}} of %{{customdata}} at %{{x}}<extra></extra>",
        **look,
    )


def _cell_text(policy: str, index: int, cell: dict[str, str] | None) -> str:
    if cell is None:
        return f"{policy}: episode {index} not played"
    ending = ending_of_row(cell)
    label = literal(ENDINGS.get(ending, (ending,))[0])
    world, seconds = literal(cell.get("scenario", "")), cell.get("time_s", "")
    after = f" after {float(seconds):.1f} s" if seconds else ""
    return f"{policy}, episode {index} ({world}): {label}{after}"


def _finished(figure: go.Figure, height: int, legend: bool | None = None) -> go.Figure:
    figure.update_layout(
        template="plotly_white",
        height=height,
        margin={"l": 10, "r": 20, "t": 30, "b": 10},
        font={"size": 13},
        legend={"orientation": "h", "yanchor": "bottom", "y": 1.0, "x": 0.0},
        showlegend=legend,
        hoverlabel={"namelength": -1},
    )
    figure.update_xaxes(automargin=True)
    figure.update_yaxes(automargin=True)
    return figure
