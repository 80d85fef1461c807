"""Success over speed and number of pedestrians, in each kind of world."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from navrl.evaluation.statistics import wilson_interval
from navrl.evaluation.stored import Evaluation
from navrl.untrusted import DamagedFileError, is_number, read_yaml
from navrl.viz.style import MARKERS, line_look, plain_text, save_figure, style

ALL_WORLDS = "all worlds"
"""Name of the pooled results of all kinds of worlds."""
_TABLE = (2, 0.6)  # dynamic pedestrians and m/s of Table I, where the paper's two sweeps meet


@dataclass(frozen=True)
class RatePoint:
    """Point of a plot: success of one policy in one kind of world at one setting.

    Args:
        policy: Name of the policy.
        world: ``corridor``, ``intersection``, ``office``, or all of them.
        suite: Name of the suite.
        num_dynamic: Number of moving pedestrians.
        speed: Speed of the moving pedestrians, m/s.
        successes: Number of successful episodes.
        episodes: Number of episodes.
    """

    policy: str
    world: str
    suite: str
    num_dynamic: int
    speed: float
    successes: int
    episodes: int

    @property
    def rate(self) -> float:
        """Success rate."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the success rate."""
        return wilson_interval(self.successes, self.episodes)


Lines = dict[tuple[str, str], list[tuple[float, RatePoint]]]
"""Lines by policy and world: pairs (speed or number, success) in ascending order."""


def plot_rates(evaluations: Sequence[Evaluation], file: str | Path) -> Path:
    """Draw success over speed and number of pedestrians, with 95 % intervals.

    The first row is over speed with two moving pedestrians, the second over number at 0.6 m/s; a
    row with fewer than two settings is omitted. Columns are kinds of worlds, the last one all of
    them, with only the settings that were played in each.

    Args:
        evaluations: Evaluations of suites that differ in speed or number; others are skipped.
        file: ``.png``, ``.svg`` or ``.pdf``.

    Returns:
        The file.

    Raises:
        ValueError: If there are fewer than two settings, or results of several simulators.

    Reference:
        Paper, figure of the performance over obstacle speeds and numbers of obstacles.
    """
    simulators = sorted({str(e.summary["simulator"]) for e in evaluations})
    points = [point for evaluation in evaluations for point in rate_points(evaluation)]
    rows = rate_rows(points)
    if not rows:
        raise ValueError(
            "source: must have evaluations at two speeds or two numbers of pedestrians at least; "
            f"found {sorted({(p.num_dynamic, p.speed) for p in points})}"
        )
    if len(simulators) > 1:
        raise ValueError(
            f"source: must have results of one simulator, found {', '.join(simulators)}"
        )
    policies, worlds = rated_policies(rows), rated_worlds(rows)
    with style():
        size = max(2.8 * len(worlds), 4.5), 2.7 * len(rows) + 0.7
        figure = Figure(size, layout="constrained")
        grid = figure.subplots(len(rows), len(worlds), sharey=True, squeeze=False)
        for axes_row, (label, lines) in zip(grid, rows.items(), strict=True):
            for axes, world in zip(axes_row, worlds, strict=True):
                _draw(axes, lines, policies, world)
                axes.set(title=plain_text(world), xlabel=label)
            axes_row[0].set_ylabel("success rate")
        _add_key(figure, policies, rows, simulators[0])
        return save_figure(figure, file)


def rate_points(evaluation: Evaluation) -> list[RatePoint]:
    """Return the success in each kind of world of an evaluation; empty for other suites."""
    setting = _setting(evaluation)
    if setting is None:
        return []
    return [
        RatePoint(
            policy=evaluation.label,
            world=world,
            suite=str(evaluation.summary["suite"]),
            num_dynamic=setting[0],
            speed=setting[1],
            successes=round(part["success_rate"] * part["episodes"]),
            episodes=part["episodes"],
        )
        for world, part in (evaluation.summary.get("by_scenario") or {}).items()
    ]


# --- which setting -------------------------------------------------------------------------------


def _setting(evaluation: Evaluation) -> tuple[int, float] | None:
    """Return number and speed of the moving pedestrians; ``None`` for another kind of suite.

    They are read from the episodes, in older files from the configuration or the suite's name.
    """
    name = str(evaluation.summary["suite"])
    if evaluation.perturbation is not None or not name.startswith(("table1", "speed", "density")):
        return None
    configured = _configured_setting(evaluation.folder / "config.yaml")
    return _played_setting(evaluation) or configured or _named_setting(name)


def _played_setting(evaluation: Evaluation) -> tuple[int, float] | None:
    counts, speeds = (evaluation.finite(c) for c in ("num_dynamic", "pedestrian_speed_mps"))
    if not len(counts) == len(speeds) == len(evaluation.episodes):
        return None
    counts, speeds = set(counts.values()), {round(speed, 2) for speed in speeds.values()}
    return (int(counts.pop()), speeds.pop()) if len(counts) == len(speeds) == 1 else None


def _named_setting(name: str) -> tuple[int, float] | None:
    match = re.fullmatch(r"(speed|density)\D*(\d+(?:[._]\d+)?)", name)
    if match is None:
        return _TABLE if name == "table1" else None
    value = float(match[2].replace("_", "."))
    return (_TABLE[0], value) if match[1] == "speed" else (int(value), _TABLE[1])


def _configured_setting(file: Path) -> tuple[int, float] | None:
    if not file.is_file():
        return None
    remedy = "delete it; the suite's name is used instead"
    distribution: object = read_yaml(file, remedy)
    for name in ("suite", "distribution"):
        distribution = distribution.get(name) or {}
        if not isinstance(distribution, dict):
            raise DamagedFileError(file, f"{name}: must hold keys", remedy)
    count, speed = distribution.get("num_dynamic"), distribution.get("speed")
    kept = distribution.get("keep_dynamic")  # at most the number placed
    count = count if kept is None else [kept, kept]
    pairs = (count, speed)
    if not all(isinstance(p, list) and len(p) == 2 and all(map(is_number, p)) for p in pairs):
        return None
    if count[0] != count[1] or speed[0] != speed[1]:
        return None
    return int(count[0]), float(speed[0])


# --- which lines ---------------------------------------------------------------------------------


def rate_rows(points: Sequence[RatePoint]) -> dict[str, Lines]:
    """Return the lines over speed and over number, by label of the axis.

    All worlds together are an additional line, for settings in which a policy played every world of
    any row. With fewer than two settings there is no row.
    """
    over = {
        f"pedestrian speed in m/s ({_TABLE[0]} moving)": (
            "speed",
            [(p.speed, p) for p in points if p.num_dynamic == _TABLE[0]],
        ),
        f"number of moving pedestrians (at {_TABLE[1]} m/s)": (
            "density",
            [(float(p.num_dynamic), p) for p in points if p.speed == _TABLE[1]],
        ),
    }
    over = {k: chosen for k, chosen in over.items() if len({x for x, _ in chosen[1]}) > 1}
    worlds = {p.world for _, chosen in over.values() for _, p in chosen}
    return {label: _lines(sweep, chosen, worlds) for label, (sweep, chosen) in over.items()}


def rated_policies(rows: Mapping[str, Lines]) -> list[str]:
    """Return the policies of some rows, the most successful one first."""
    points: dict[str, list[RatePoint]] = defaultdict(list)
    for point in _each(rows):
        points[point.policy].append(point)
    return sorted(points, key=lambda policy: (-_pooled(points[policy]).rate, policy))


def rated_worlds(rows: Mapping[str, Lines]) -> list[str]:
    """Return the worlds of some rows, all of them together last."""
    return sorted({p.world for p in _each(rows)}, key=lambda w: (w == ALL_WORLDS, w))


def rated_settings(lines: Lines) -> list[float]:
    """Return the speeds or numbers with results."""
    return sorted({x for line in lines.values() for x, _ in line})


def _lines(sweep: str, chosen: Sequence[tuple[float, RatePoint]], worlds: set[str]) -> Lines:
    """Join points to lines; of two suites use the sweep's own, then the one with more episodes.

    Suites are not pooled, since they overlap: ``table1_200`` is the beginning of ``table1``.
    """
    best = {
        (p.policy, p.world, x): p
        for x, p in sorted(chosen, key=lambda c: (c[1].suite.startswith(sweep), c[1].episodes))
    }
    lines: Lines = defaultdict(list)
    parts: dict[tuple[str, float], list[RatePoint]] = defaultdict(list)
    for policy, world, x in sorted(best):
        lines[policy, world].append((x, best[policy, world, x]))
        parts[policy, x].append(best[policy, world, x])
    for (policy, x), members in sorted(parts.items()):
        if len(members) == len(worlds) > 1:
            lines[policy, ALL_WORLDS].append((x, _pooled(members)))
    return dict(lines)


def _pooled(points: Sequence[RatePoint]) -> RatePoint:
    return replace(
        points[0],
        world=ALL_WORLDS,
        successes=sum(p.successes for p in points),
        episodes=sum(p.episodes for p in points),
    )


def _each(rows: Mapping[str, Lines]) -> list[RatePoint]:
    return [p for lines in rows.values() for line in lines.values() for _, p in line]


# --- parts ---------------------------------------------------------------------------------------


def _draw(axes: Axes, lines: Lines, policies: Sequence[str], world: str) -> None:
    for i, policy in enumerate(policies):
        line = lines.get((policy, world), [])
        if not line:
            continue
        xs = [x for x, _ in line]
        low, high = zip(*(p.interval for _, p in line), strict=True)
        axes.fill_between(xs, low, high, color=_look(i)["color"], alpha=0.15, linewidth=0)
        axes.plot(xs, [p.rate for _, p in line], **_look(i))
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    settings = rated_settings(lines)
    if len(settings) <= 8:
        axes.set_xticks(settings)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(6))


def _look(i: int) -> dict:
    """Return color, marker and dash of the i-th policy, distinct also without colors."""
    return {**line_look(i), "marker": MARKERS[i % len(MARKERS)], "markersize": 3.5}


def _add_key(
    figure: Figure, policies: Sequence[str], rows: Mapping[str, Lines], simulator: str
) -> None:
    handles = [
        Line2D([], [], label=plain_text(policy), **_look(i)) for i, policy in enumerate(policies)
    ]
    counts = [p.episodes for p in _each(rows) if p.world != ALL_WORLDS]
    shown = " to ".join(f"{n:,}" for n in dict.fromkeys((min(counts), max(counts))))
    inches = 0.55 + 0.058 * max(map(len, policies))  # width of an entry, in 7 points
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=max(1, min(len(handles), 6, int(figure.get_figwidth() / inches))),
        title=f"{plain_text(simulator)}; {shown} episodes per point and world; "
        "bands: 95 % intervals",
        title_fontsize=7,
    )
