"""Learning curves from the logs of one or more training runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter, MaxNLocator, PercentFormatter

from navrl.untrusted import DamagedFileError, read_table
from navrl.viz.style import BLACK, GRAY, line_look, plain_text, save_figure, style

_REMEDY = "restore the log, or remove its damaged rows"
Series = tuple[np.ndarray, np.ndarray]
_LEVELS = ("train/max_dynamic", "evaluation/max_dynamic")  # a bundle's curve has only the latter


@dataclass(frozen=True)
class _Panel:
    title: str
    unit: str
    evaluated: str | None  # column of the evaluations, drawn with markers
    trained: Callable[[TrainingLog], Series]  # drawn thin beside evaluations
    is_rate: bool = False
    is_level: bool = False  # a step function, not averaged over runs

    def has_data(self, log: TrainingLog) -> bool:
        """Return whether a log has data for this panel."""
        evaluated = log.sum_of([self.evaluated] if self.evaluated else [])
        return any(len(frames) for frames, _ in (evaluated, self.trained(log)))


class TrainingLog:
    """Columns of a ``metrics.csv`` or ``curve.csv``, without empty cells."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._rows = read_table(file, _REMEDY, is_log=True)
        if not self._rows or "frames" not in self._rows[0]:
            raise ValueError(f"{file}: must be a training log with a column 'frames' and a row")

    def column(self, name: str) -> Series:
        """Return frames and values, both ``[n]``."""
        return self.sum_of([name])

    def sum_of(self, names: Sequence[str]) -> Series:
        """Return frames and the sum of columns, where all of them are logged."""
        logged = [row for row in self._rows if names and all(row.get(name) for name in names)]
        try:
            frames = np.array([float(row["frames"]) for row in logged])
            values = np.array([sum(float(row[name]) for name in names) for row in logged])
        except ValueError as error:
            raise DamagedFileError(self._file, f"must hold numbers ({error})", _REMEDY) from error
        return frames, values

    def levels(self) -> Series:
        """Return frames and the curriculum's number of pedestrians."""
        logged = (self.column(name) for name in _LEVELS)
        return next((series for series in logged if len(series[0])), self.column(_LEVELS[0]))

    def names(self, prefix: str) -> list[str]:
        """Return the columns with a prefix."""
        return [name for name in self._rows[0] if name.startswith(prefix)]


def plot_curves(
    csv_files: Sequence[str | Path],
    out: str | Path,
    labels: Sequence[str] | None = None,
    formats: Sequence[str] = (".png", ".svg"),
) -> list[Path]:
    """Draw learning curves.

    The panels show rates of each outcome, the curriculum's number of pedestrians, reward, and
    Q-values and loss of the critic over environment steps; panels without data are omitted.
    Evaluations are lines with markers, training episodes (with exploration) are thin lines; a
    dotted line marks a new curriculum level, if there is only one setting. Runs with the same label
    are seeds of one setting: each is drawn pale, with their mean and a band from minimum to
    maximum.

    Args:
        csv_files: ``metrics.csv`` of each run, or ``curve.csv`` of its bundle.
        out: File; a suffix is replaced.
        labels: Name of each run; the name of its folder if ``None``.
        formats: Suffixes: ``.png``, ``.svg``, ``.pdf``.

    Returns:
        One file per format.

    Raises:
        FileNotFoundError: If a log does not exist.
        ValueError: If there is no log, one is empty or not a training log, or the number of labels
            differs from that of logs.
    """
    files = [Path(file) for file in csv_files]
    labels = [file.resolve().parent.name for file in files] if labels is None else list(labels)
    if not files or len(labels) != len(files):
        raise ValueError(f"must be one label per log, at least one: {len(labels)}, {len(files)}")
    groups: dict[str, list[TrainingLog]] = {}
    for label, file in zip(labels, files, strict=True):
        groups.setdefault(label, []).append(TrainingLog(file))
    logs = [log for group in groups.values() for log in group]
    panels = [panel for panel in _PANELS if any(map(panel.has_data, logs))] or [_PANELS[0]]
    columns = -(-len(panels) // 2)
    with style():
        figure = Figure((max(2.75 * columns, 5.5), 5.2), layout="constrained")
        for i, panel in enumerate(panels):
            axes = figure.add_subplot(2, columns, i + 1)
            for j, (label, group) in enumerate(groups.items()):
                _draw(axes, panel, group, label, **line_look(j))
            if len(groups) == 1 and panel.evaluated is not None:
                _mark_levels(axes, logs)
            _finish(axes, panel)
        _add_key(figure, groups, ncols=max(2 * columns - 2, 2))  # names of about 30 letters fit
        out = Path(out)
        return [save_figure(figure, out.with_suffix(suffix)) for suffix in formats]


def _rate(title: str, outcome: str) -> _Panel:
    column = f"{outcome}_rate"
    return _Panel(
        title,
        "share of episodes",
        f"evaluation/{column}",
        lambda log: log.column(f"train/{column}"),
        is_rate=True,
    )


_PANELS = (
    _rate("success", "success"),
    _rate("collision with a pedestrian", "collision_pedestrian"),
    _rate("collision with a wall", "collision_static"),
    _rate("timeout", "timeout"),
    _Panel(
        "curriculum",
        "dynamic pedestrians, at most",
        None,
        TrainingLog.levels,
        is_level=True,
    ),
    _Panel("reward", "mean of a step", None, lambda log: log.sum_of(log.names("reward/"))),
    _Panel("action value Q", "mean of a batch", None, lambda log: log.column("learn/q_mean")),
    _Panel("critic loss", "mean of a batch", None, lambda log: log.column("learn/loss_critic")),
)


def _draw(
    axes: Axes,
    panel: _Panel,
    logs: Sequence[TrainingLog],
    label: str,
    color: str,
    linestyle: str,
) -> None:
    trained = [panel.trained(log) for log in logs]
    if panel.is_level:
        for series in trained:
            axes.plot(*series, color=color, linestyle=linestyle, drawstyle="steps-post")
    elif panel.evaluated is None:
        _draw_seeds(axes, trained, label, color, linestyle=linestyle)
    else:
        for series in trained:
            axes.plot(*series, color=color, linewidth=0.6, alpha=0.4)
        evaluated = [log.column(panel.evaluated) for log in logs]
        look = {"linestyle": linestyle, "marker": "o", "markersize": 2.5}
        _draw_seeds(axes, evaluated, label, color, **look)


def _mark_levels(axes: Axes, logs: Sequence[TrainingLog]) -> None:
    color = line_look(0)["color"]
    for frames, levels in (log.levels() for log in logs):
        for frame in frames[1:][np.diff(levels) > 0]:
            axes.axvline(frame, color=color, linestyle=":", linewidth=0.8)


def _draw_seeds(axes: Axes, seeds: Sequence[Series], label: str, color: str, **look: Any) -> None:
    """Draw a single run, or several runs pale with their mean and range."""
    seeds = [series for series in seeds if len(series[0])]
    if not seeds:
        return
    if len(seeds) == 1:
        axes.plot(*seeds[0], label=label, color=color, **look)
        return
    for frames, values in seeds:
        axes.plot(frames, values, color=color, linewidth=0.8, alpha=0.6)
    first, last = max(f[0] for f, _ in seeds), min(f[-1] for f, _ in seeds)
    common = np.unique(np.concatenate([frames for frames, _ in seeds]))
    common = common[(first <= common) & (common <= last)]
    values = np.array([np.interp(common, *series) for series in seeds])
    low, high = values.min(axis=0, initial=np.inf), values.max(axis=0, initial=-np.inf)
    axes.fill_between(common, low, high, color=color, alpha=0.15, linewidth=0)
    axes.plot(common, values.mean(axis=0), label=label, color=color, **look)


def _finish(axes: Axes, panel: _Panel) -> None:
    axes.set(title=panel.title, ylabel=panel.unit, xlabel="environment steps")
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlim(left=0.0)
    if panel.is_rate:
        axes.set_ylim(-0.02, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    if panel.is_level:
        axes.set_ylim(bottom=0.0)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def _add_key(figure: Figure, groups: dict[str, list[TrainingLog]], ncols: int) -> None:
    handles = []
    for i, (label, logs) in enumerate(groups.items()):
        seeds = "" if len(logs) == 1 else f" (mean of {len(logs)} seeds)"
        handles.append(Line2D([], [], label=plain_text(label) + seeds, **line_look(i)))
    marks = {"evaluation, no exploration": {"marker": "o", "markersize": 2.5}}
    if any(log.names("train/") for logs in groups.values() for log in logs):
        marks["training, with exploration"] = {"linewidth": 0.6, "alpha": 0.5}
    if len(groups) == 1:
        marks["more pedestrians from here"] = {"linestyle": ":", "linewidth": 0.8}
    handles += [Line2D([], [], color=BLACK, label=label, **look) for label, look in marks.items()]
    if any(len(logs) > 1 for logs in groups.values()):
        handles.append(Patch(color=GRAY, alpha=0.3, linewidth=0, label="range of the seeds"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), ncols))
