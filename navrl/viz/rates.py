"""Success over the speed and over the number of pedestrians, in each kind of world."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, PercentFormatter

from navrl.evaluation.stored import Evaluation
from navrl.viz.style import line_look, save_figure, style

_TABLE = (2, 0.6)  # dynamic pedestrians and m/s of Table I, where the paper's two sweeps meet
_ALL = "all worlds"
_MARKERS = "osD^vPX"


@dataclass(frozen=True)
class RatePoint:
    """Success of one policy in one kind of world at one setting.

    Args:
        policy: Name.
        world: ``corridor``, ``intersection``, ``office``, or all of them.
        num_dynamic: Walking pedestrians.
        speed: m/s, theirs.
        rate: Share of episodes won.
        interval: 95 %, of that share.
        episodes: Number played.
    """

    policy: str
    world: str
    num_dynamic: int
    speed: float
    rate: float
    interval: tuple[float, float]
    episodes: int


def plot_rates(evaluations: Sequence[Evaluation], file: str | Path) -> Path:
    """Draw success over pedestrians' speed and over their number, with 95 % intervals.

    The first row is over speed with two walking pedestrians, the second over number at 0.6 m/s; a
    row without two settings is left out. Columns are kinds of worlds, the last one all of them.

    Args:
        evaluations: Of suites that differ in speed or number; others are passed over.
        file: ``.png``, ``.svg`` or ``.pdf``.

    Returns:
        The file.

    Raises:
        ValueError: If there is nothing to draw a line through, or results of several simulators.

    Reference:
        Paper, figure of the performance over obstacle speeds and numbers of obstacles.
    """
    simulators = sorted({str(e.summary["simulator"]) for e in evaluations})
    points = [point for evaluation in evaluations for point in rate_points(evaluation)]
    rows = [row for row in (speed_row(points), number_row(points)) if row is not None]
    if not rows:
        raise ValueError(
            "source: success over speed or number needs evaluations at two speeds or two numbers "
            f"of pedestrians at least; found {sorted({(p.num_dynamic, p.speed) for p in points})}"
        )
    if len(simulators) > 1:
        raise ValueError(f"source: needs results of one simulator, found {', '.join(simulators)}")
    policies = sorted({p.policy for p in points}, key=lambda policy: -_mean_rate(points, policy))
    worlds = [w for w in dict.fromkeys(p.world for p in points) if w != _ALL]
    worlds = [*sorted(worlds), _ALL]
    with style():
        figure = Figure((2.8 * len(worlds), 2.7 * len(rows) + 0.7), layout="constrained")
        grid = figure.subplots(len(rows), len(worlds), sharey=True, squeeze=False)
        for axes_row, (label, chosen) in zip(grid, rows, strict=True):
            for axes, world in zip(axes_row, worlds, strict=True):
                _draw(axes, chosen, policies, world)
                axes.set(title=world, xlabel=label)
            axes_row[0].set_ylabel("success rate")
        _add_key(figure, policies, points, simulators[0])
        return save_figure(figure, file)


def rate_points(evaluation: Evaluation) -> list[RatePoint]:
    """Return the success rate in each kind of world and in all; empty of a suite of no sweep."""
    setting = _setting(evaluation)
    if setting is None:
        return []
    parts: dict[str, Mapping] = {**evaluation.summary.get("by_scenario", {})}
    parts[_ALL] = evaluation.summary
    return [
        RatePoint(
            policy=evaluation.label,
            world=world,
            num_dynamic=setting[0],
            speed=setting[1],
            rate=part["success_rate"],
            interval=tuple(part["success_interval"]),
            episodes=part["episodes"],
        )
        for world, part in parts.items()
    ]


# --- which setting -------------------------------------------------------------------------------


def _setting(evaluation: Evaluation) -> tuple[int, float] | None:
    """Return number and speed of the walking pedestrians; ``None`` of another kind of suite.

    The episodes tell, in files of before they did the configuration, or else the suite's name.
    """
    name = str(evaluation.summary["suite"])
    if not name.startswith(("table1", "speed", "density")):
        return None
    configured = _configured_setting(evaluation.folder / "config.yaml")
    return _played_setting(evaluation) or configured or _named_setting(name)


def _played_setting(evaluation: Evaluation) -> tuple[int, float] | None:
    rows = evaluation.episodes.values()
    settings = {(row.get("num_dynamic"), row.get("pedestrian_speed_mps")) for row in rows}
    counts = {count for count, _ in settings}
    if len(counts) != 1 or not all(count and speed for count, speed in settings):
        return None
    speeds = {round(float(speed), 2) for _, speed in settings}
    return (int(counts.pop()), speeds.pop()) if len(speeds) == 1 else None


def _named_setting(name: str) -> tuple[int, float] | None:
    match = re.fullmatch(r"(speed|density)\D*(\d+(?:[._]\d+)?)", name)
    if match is None:
        return _TABLE if name == "table1" else None
    value = float(match[2].replace("_", "."))
    return (_TABLE[0], value) if match[1] == "speed" else (int(value), _TABLE[1])


def _configured_setting(file: Path) -> tuple[int, float] | None:
    if not file.is_file():
        return None
    suite = yaml.safe_load(file.read_text()).get("suite") or {}
    distribution = suite.get("distribution") or {}
    count, speed = distribution.get("num_dynamic"), distribution.get("speed")
    if not count or not speed or count[0] != count[1] or speed[0] != speed[1]:
        return None
    return int(count[0]), float(speed[0])


Row = tuple[str, dict[float, list[RatePoint]]]


def speed_row(points: Sequence[RatePoint]) -> Row | None:
    """Return the points over speed, by speed; ``None`` of fewer than two."""
    chosen = [(p.speed, p) for p in points if p.num_dynamic == _TABLE[0]]
    return _row(f"pedestrian speed in m/s ({_TABLE[0]} walking)", chosen)


def number_row(points: Sequence[RatePoint]) -> Row | None:
    """Return the points over the number of pedestrians, by number; ``None`` of fewer than two."""
    chosen = [(float(p.num_dynamic), p) for p in points if p.speed == _TABLE[1]]
    return _row(f"walking pedestrians (at {_TABLE[1]} m/s)", chosen)


def _row(label: str, chosen: Sequence[tuple[float, RatePoint]]) -> Row | None:
    at: dict[float, dict[tuple[str, str], RatePoint]] = {}
    for x, point in sorted(chosen, key=lambda pair: pair[1].episodes):
        at.setdefault(x, {})[point.policy, point.world] = point  # of two, the one of more episodes
    if len(at) < 2:
        return None
    return label, {x: list(points.values()) for x, points in sorted(at.items())}


# --- parts ---------------------------------------------------------------------------------------


def _draw(
    axes: Axes, at: Mapping[float, Sequence[RatePoint]], policies: Sequence[str], world: str
) -> None:
    for i, policy in enumerate(policies):
        found = [
            (x, p)
            for x, points in at.items()
            for p in points
            if (p.policy, p.world) == (policy, world)
        ]
        if not found:
            continue
        xs = [x for x, _ in found]
        low, high = zip(*(p.interval for _, p in found), strict=True)
        axes.fill_between(xs, low, high, color=_look(i)["color"], alpha=0.15, linewidth=0)
        axes.plot(xs, [p.rate for _, p in found], **_look(i))
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.set_xticks(list(at)) if len(at) <= 8 else axes.xaxis.set_major_locator(MaxNLocator(6))


def _mean_rate(points: Sequence[RatePoint], policy: str) -> float:
    rates = [p.rate for p in points if (p.policy, p.world) == (policy, _ALL)]
    return sum(rates) / len(rates)


def _look(i: int) -> dict:
    """Return colour, mark and dash of the i-th policy: told apart without colours too."""
    return {**line_look(i), "marker": _MARKERS[i % len(_MARKERS)], "markersize": 3.5}


def _add_key(
    figure: Figure, policies: Sequence[str], points: Sequence[RatePoint], simulator: str
) -> None:
    handles = [Line2D([], [], label=policy, **_look(i)) for i, policy in enumerate(policies)]
    counts = sorted({p.episodes for p in points if p.world == _ALL})
    shown = " to ".join(f"{count:,}" for count in dict.fromkeys((counts[0], counts[-1])))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=min(len(handles), 6),
        title=f"{simulator}; {shown} episodes a point in all worlds; bands: 95 % intervals",
        title_fontsize=7,
    )
