"""Figure of a benchmark report: bars, growth of costs and phases of training."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from navrl.untrusted import DamagedFileError, read_json
from navrl.viz.style import BLACK, BLUE, CYCLE, GRAY, GREEN, VERMILLION, save_figure, style

_REMEDY = "run navrl-benchmark again"
_COLUMNS = 3  # columns of small panels, right of the bars
_GROWTH, _TRAINING = "growth.", "training."
_NOT_PHASES = ("training.frames", "training.updates")


def plot_benchmark(json_file: str | Path, out: str | Path) -> list[Path]:
    """Draw a benchmark report as PNG and SVG.

    On the left, the ratio of each quantity to its bar, with the middle half of its measurements; on
    the right, the growth of costs with the fitted exponent, and the phases of a training.

    Args:
        json_file: The ``benchmark.json`` of a run.
        out: File; a suffix is replaced.

    Returns:
        The two files.

    Raises:
        FileNotFoundError: If the report does not exist.
        ValueError: If it has no rows.
    """
    report = read_json(json_file, _REMEDY)
    if not report.get("rows"):
        raise ValueError(f"{json_file}: must be a benchmark report with rows")
    with style():
        try:
            figure = _draw(report)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            reason = f"not a benchmark report ({type(error).__name__}: {error})"
            raise DamagedFileError(json_file, reason, _REMEDY) from error
        out = Path(out)
        return [save_figure(figure, out.with_suffix(suffix)) for suffix in (".png", ".svg")]


def _draw(report: Mapping) -> Figure:
    rows = {row["key"]: row for row in report["rows"]}
    with_bar = [row for key, row in rows.items() if row["bar"] and not key.startswith(_GROWTH)]
    shares = [rows[key] for key in rows if key.startswith(_TRAINING) and key not in _NOT_PHASES]
    panels: list[Callable[[Axes], None]] = [
        lambda axes, series=series: _draw_growth(axes, series, rows[_GROWTH + series["key"]])
        for series in report["series"]
    ]
    if shares:
        panels.append(lambda axes: _draw_shares(axes, shares))
    height = max(1, -(-len(panels) // _COLUMNS))
    figure = Figure((12.0, max(2.9 * height, 0.42 * len(with_bar) + 1.2)), layout="constrained")
    grid = GridSpec(height, 1 + _COLUMNS, figure, width_ratios=[1.15] + [1.0] * _COLUMNS)
    if with_bar:
        whole = grid[:, 0] if panels else grid[:, :]
        _draw_bars(figure.add_subplot(whole), with_bar)
    for i, draw in enumerate(panels):
        draw(figure.add_subplot(grid[i // _COLUMNS, 1 + i % _COLUMNS]))
    machine = report["machine"]
    figure.suptitle(
        f"{machine['processor']}, {machine['cores']} cores", fontsize=9, x=0.01, ha="left"
    )
    return figure


# --- bars ----------------------------------------------------------------------------------------


def _draw_bars(axes: Axes, rows: Sequence[Mapping]) -> None:
    """Draw the ratio of each row to its bar on a logarithmic axis."""
    for i, row in enumerate(rows):
        color, marker = (GREEN, "o") if row["met"] else (VERMILLION, "X")
        ends = sorted(_margin(row, value) for value in row["quartiles"])
        axes.plot(ends, [i, i], color=color, linewidth=2.5, alpha=0.4, solid_capstyle="butt")
        axes.plot(_margin(row, row["median"]), i, marker, color=color, markersize=5)
        sign = "≥" if row["bar"]["least"] else "≤"
        text = f"{_number(row['median'])} {row['unit']} (bar {sign} {_number(row['bar']['limit'])})"
        axes.annotate(
            f"{_full_label(row)}\n{text}",
            (0.0, i),
            xycoords=("axes fraction", "data"),
            xytext=(-4, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=6.5,
        )
    axes.axvline(1.0, color=BLACK, linewidth=0.8)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_yticks([])
    _logarithmic(axes, "x")
    axes.set(title="bars reached", xlabel="times better than the bar")


def _margin(row: Mapping, value: float) -> float:
    limit = row["bar"]["limit"]
    return value / limit if row["bar"]["least"] else limit / value


def _full_label(row: Mapping) -> str:
    """Return a row's label outside of the table, with ``…`` replaced by the row above."""
    return row["label"].replace("… ", f"{row['key'].partition('.')[0]}: ")


# --- growth and time -----------------------------------------------------------------------------


def _draw_growth(axes: Axes, series: Mapping, exponent: Mapping) -> None:
    sizes, median = np.array(series["sizes"]), np.array(series["median"])
    low, high = np.array(series["quartiles"]).T
    axes.errorbar(
        sizes, median, (median - low, high - median), color=BLUE, marker="o", markersize=3
    )
    middle = np.exp(np.log(median).mean()), np.exp(np.log(sizes).mean())
    fit = middle[0] * (sizes / middle[1]) ** exponent["median"]
    bar = f" (bar ≤ {exponent['bar']['limit']:g})" if exponent["bar"] else ""
    axes.plot(sizes, fit, color=GRAY, linestyle="--", linewidth=0.9)
    _logarithmic(axes, "x", sizes)
    _logarithmic(axes, "y")
    power = f"dashed: the power {exponent['median']:.2f}{bar}"
    axes.set(title=f"growth with {series['size']}\n{power}", xlabel=series["size"])
    axes.set_ylabel(f"{series['label']}, {series['unit']}")


def _draw_shares(axes: Axes, rows: Sequence[Mapping]) -> None:
    """Draw the phases of a training iteration as bars of their share."""
    names = [row["label"].partition(": ")[2] for row in rows]
    for i, row in enumerate(rows):
        axes.barh(i, row["median"], color=CYCLE[i % len(CYCLE)], height=0.6)
        axes.annotate(
            f"{names[i]}, {row['median']:.1f} %",
            (0.0, i - 0.34),
            xytext=(1, 0),
            textcoords="offset points",
            va="bottom",
            fontsize=7,
        )
    axes.set_ylim(len(rows) - 0.5, -0.9)
    axes.set_yticks([])
    axes.set(title="a training's time", xlabel="%", xlim=(0, 100))


def _logarithmic(axes: Axes, which: str, ticks: Sequence[float] | None = None) -> None:
    """Make an axis logarithmic, with few plain tick labels."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    axis.set_major_formatter(FuncFormatter(lambda value, _: _number(value)))
    if ticks is not None:
        axis.set_minor_locator(NullLocator())
        axis.set_ticks(ticks, [_number(tick) for tick in ticks])
        return
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0,) if high / low > 100 else (1.0, 2.0, 5.0)))
    axis.set_minor_formatter(NullFormatter())


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
