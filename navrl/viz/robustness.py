"""Success under named perturbations: a dot with its interval for each policy, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from navrl.evaluation.robustness import RobustnessRow, RobustnessTable, robustness_tables
from navrl.evaluation.stored import Evaluation
from navrl.viz.style import BLACK, GRAY, MARKERS, line_look, plain_text, save_figure, style

_TICK = {"color": BLACK, "marker": "|", "markersize": 9.0, "markeredgewidth": 1.4, "linestyle": ""}
_SPREAD = 0.6  # rows, height of the dots of one row


def plot_robustness(evaluations: Sequence[Evaluation], file: str | Path) -> Path:
    """Draw the success of each policy under each perturbation, with 95 % Wilson intervals.

    Privileged policies, such as the oracle, are vertical ticks: ceilings of the row. Lines separate
    the kinds of perturbations.

    Args:
        evaluations: Evaluations of one suite; those without perturbation are skipped.
        file: ``.png``, ``.svg`` or ``.pdf``.

    Returns:
        The file.

    Raises:
        ValueError: If there are no perturbed evaluations, or those of several suites or simulators.
    """
    tables = robustness_tables(evaluations)
    if len(tables) != 1:
        found = ", ".join(f"{table.suite} ({table.simulator})" for table in tables) or "none"
        raise ValueError(
            f"source: must have perturbed evaluations of one suite and simulator, found {found}; "
            "navrl-evaluate -m sweep=robustness plays them"
        )
    table = tables[0]
    with style():
        figure = Figure((6.5, 1.2 + 0.24 * len(table.rows)), layout="constrained")
        axes = figure.subplots()
        _draw(axes, table)
        episodes = {rate.episodes for row in table.rows for rate in row.rates.values()}
        counts = " to ".join(f"{n:,}" for n in sorted({min(episodes), max(episodes)}))
        figure.legend(
            handles=_handles(table),
            loc="outside lower center",
            ncols=4,
            title=f"{plain_text(table.suite)}, {plain_text(table.simulator)}; {counts} episodes "
            "per dot; bars: 95 % intervals",
            title_fontsize=7,
        )
        return save_figure(figure, file)


def _draw(axes: Axes, table: RobustnessTable) -> None:
    fair = [policy for policy in table.policies if policy not in table.privileged]
    for place, row in enumerate(table.rows):
        for i, policy in enumerate(fair):
            _dot(axes, row, policy, place + _offset(i, len(fair)), i)
        for policy in table.privileged & row.rates.keys():
            axes.plot(row.rates[policy].rate, place, **_TICK)
        if place and row.kind != table.rows[place - 1].kind:
            axes.axhline(place - 0.5, color=GRAY, linewidth=0.6)
    axes.set_yticks(range(len(table.rows)), [plain_text(row.about) for row in table.rows])
    axes.set_ylim(len(table.rows) - 0.5, -0.5)  # first row on top
    axes.set_xlim(-0.02, 1.02)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_xlabel("success rate")


def _dot(axes: Axes, row: RobustnessRow, policy: str, place: float, i: int) -> None:
    found = row.rates.get(policy)
    if found is not None:
        axes.plot(found.interval, (place, place), color=_look(i)["color"], linewidth=1.0)
        axes.plot(found.rate, place, **_look(i))


def _offset(i: int, count: int) -> float:
    return _SPREAD * ((i + 0.5) / count - 0.5)


def _look(i: int) -> dict:
    """Return color and marker of the i-th policy, distinct also without colors."""
    color = line_look(i)["color"]
    marker = MARKERS[i % len(MARKERS)]
    return {"color": color, "marker": marker, "markersize": 3.0, "linestyle": ""}


def _handles(table: RobustnessTable) -> list[Line2D]:
    fair = [policy for policy in table.policies if policy not in table.privileged]
    handles = [Line2D([], [], label=plain_text(name), **_look(i)) for i, name in enumerate(fair)]
    return handles + [
        Line2D([], [], label=f"{plain_text(name)} (privileged)", **_TICK)
        for name in table.policies
        if name in table.privileged
    ]
