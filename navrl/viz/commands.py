"""Picture of a replay: commands, states and alignment over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from navrl.viz.style import BLUE, CYCLE, GRAY, GREEN, ORANGE, VERMILLION, plain_text, save_figure
from navrl.viz.style import style as styled

_STATE_COLORS = {"drive": GREEN, "at_goal": BLUE, "blocked": ORANGE}
_OTHERS = tuple(color for color in CYCLE if color not in _STATE_COLORS.values())


Pair = tuple[float, float]


class Status(Protocol):
    """Status of a controller: :class:`navrl.deploy.ControlStatus`."""

    @property
    def state(self) -> str:
        """State, e.g. ``drive``."""
        ...

    @property
    def command(self) -> Sequence[Any]:
        """Speed in m/s and turn rate in rad/s first."""
        ...


class Tick(Protocol):
    """State of a replay after a tick: :class:`navrl.deploy.replay.ReplayedTick`."""

    time_s: float
    requested: Pair | None
    is_shielded: bool
    recorded: Pair | None
    measured: Pair | None
    icp_error: Pair | None

    @property
    def status(self) -> Status:
        """Status of the controller."""
        ...


def plot_commands(ticks: Sequence[Tick], file: str | Path, title: str = "") -> Path:
    """Draw speed, turn rate, state and alignment error over time.

    Args:
        ticks: States of a replay, at least one.
        file: ``.png``, ``.svg`` or ``.pdf``.
        title: Title of the figure.

    Returns:
        The file.
    """
    with styled():
        figure = Figure((9.0, 6.5), layout="constrained")
        grid = {"height_ratios": [3, 3, 0.6, 2]}
        panels = figure.subplots(4, 1, sharex=True, gridspec_kw=grid)
        for index, name in enumerate(("v in m/s", "w in rad/s")):
            _draw_commands(panels[index], ticks, index)
            panels[index].set_ylabel(name)
        panels[0].legend(loc="upper left", ncols=5, bbox_to_anchor=(0.0, 1.18))
        _draw_states(panels[2], ticks)
        _draw_alignment(panels[3], ticks)
        panels[3].set_xlabel("time in s")
        figure.suptitle(plain_text(title), fontsize=9, x=0.01, ha="left")
        return save_figure(figure, file)


def _draw_commands(axes: Axes, ticks: Sequence[Tick], index: int) -> None:
    time = [tick.time_s for tick in ticks]
    lines = {
        "odometry": ([tick.measured for tick in ticks], GRAY, 0.8),
        "recorded command": ([tick.recorded for tick in ticks], ORANGE, 1.2),
        "policy": ([tick.status.command[:2] for tick in ticks], BLUE, 1.2),
    }
    for label, (pairs, color, width) in lines.items():
        if any(pair is not None for pair in pairs):
            values = [np.nan if pair is None else pair[index] for pair in pairs]
            axes.step(time, values, where="post", color=color, linewidth=width, label=label)
    replaced = [tick for tick in ticks if tick.is_shielded and tick.requested is not None]
    if replaced:
        asked = [tick.requested[index] for tick in replaced if tick.requested is not None]
        look = {"color": VERMILLION, "markersize": 3, "label": "replaced by the shield"}
        axes.plot([tick.time_s for tick in replaced], asked, "x", **look)


def _draw_states(axes: Axes, ticks: Sequence[Tick]) -> None:
    states = [str(tick.status.state) for tick in ticks]
    edges = [0, *(k for k in range(1, len(ticks)) if states[k] != states[k - 1]), len(ticks)]
    seen = list(dict.fromkeys(states))
    others = [state for state in seen if state not in _STATE_COLORS]
    colors = _STATE_COLORS | {s: _OTHERS[k % len(_OTHERS)] for k, s in enumerate(others)}
    end = 2 * ticks[-1].time_s - ticks[-2].time_s if len(ticks) > 1 else ticks[-1].time_s + 0.05
    times = [*(tick.time_s for tick in ticks), end]
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        axes.axvspan(times[first], times[last], color=colors[states[first]], linewidth=0)
    patches = [Patch(color=colors[state], label=state) for state in seen]
    axes.legend(handles=patches, loc="upper left", ncols=6, bbox_to_anchor=(0.0, -0.1))
    axes.set(yticks=[], ylabel="state")
    axes.grid(False)


def _draw_alignment(axes: Axes, ticks: Sequence[Tick]) -> None:
    """Draw the difference between the alignment and the motion by the poses."""
    pairs = [(tick.time_s, *tick.icp_error) for tick in ticks if tick.icp_error is not None]
    if pairs:
        time, error, turn = np.array(pairs).T
        axes.plot(time, error, ".", color=BLUE, markersize=2.5, label="position / m")
        axes.plot(
            time, np.degrees(turn) / 20.0, ".", color=ORANGE, markersize=2.5, label="turn / 20°"
        )
        axes.axhline(0.1, color=GRAY, linewidth=0.8)  # 0.1 m and 2 degrees
        axes.set_ylim(0.0, 0.4)
        axes.legend(loc="upper right", ncols=2)
    axes.set_ylabel("ICP - poses")
