"""Picture of a robot's scan beside one of the training, from above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge

from navrl.viz.style import BLACK, BLUE, GRAY, PURPLE, VERMILLION, plain_text, save_figure, style


class ScanLayout(Protocol):
    """Values of a lidar that a picture of its scans needs, e.g. of :class:`navrl.sim.Lidar`."""

    max_range: float
    mount: tuple[float, float, float]

    @property
    def increment(self) -> float:
        """Angle from a beam to the next, rad."""
        ...

    def beam_angles(self) -> object:
        """Return the bearings ``[N]`` rad of the beams in the lidar's frame."""
        ...


def plot_scans(
    scans: Sequence[tuple[str, np.ndarray]], lidar: ScanLayout, radius: float, file: str | Path
) -> Path:
    """Draw scans as a policy gets them, side by side, with the robot's front upward.

    Args:
        scans: Title and ranges ``[N]`` m of each scan, as :func:`navrl.deploy.adapt_scan` gives
            them.
        lidar: Lidar of the policy.
        radius: Radius of the robot, m.
        file: ``.png``, ``.svg`` or ``.pdf``.

    Returns:
        The file.
    """
    with style():
        figure = Figure((4.6 * len(scans), 4.9), layout="constrained")
        panels = figure.subplots(1, len(scans), squeeze=False)[0]
        for axes, (title, ranges) in zip(panels, scans, strict=True):
            _draw_scan(axes, ranges, lidar, radius)
            axes.set_title(plain_text(title), fontsize=8)
        return save_figure(figure, file)


def _draw_scan(axes: Axes, ranges: np.ndarray, lidar: ScanLayout, radius: float) -> None:
    reach, (x, y, turn) = lidar.max_range, lidar.mount
    bearing = np.asarray(lidar.beam_angles()) + turn
    up = bearing + 0.5 * math.pi  # the robot's front is drawn upward
    center = (-y, x)
    is_return = np.isfinite(ranges) & (ranges < reach)
    unseen, near = np.isnan(ranges), np.isneginf(ranges)
    half = 0.5 * abs(math.degrees(lidar.increment))
    for angle in np.degrees(up[unseen]):
        look = {"facecolor": "#DDDDDD", "linewidth": 0}
        axes.add_patch(Wedge(center, reach, angle - half, angle + half, **look))
    far = ~is_return & ~unseen & ~near
    for mask, distance, color, label in (
        (is_return, ranges, BLACK, "return"),
        (far, np.full_like(ranges, reach), BLUE, "free"),
        (near, np.full_like(ranges, radius), VERMILLION, "too near"),
    ):
        ends = distance[mask, None] * np.stack([np.cos(up[mask]), np.sin(up[mask])], axis=-1)
        size = 2.0 if color == BLACK else 0.8
        axes.plot(*(ends + center).T, ".", color=color, markersize=size, label=label)
    axes.add_patch(Circle((0.0, 0.0), radius, facecolor=PURPLE, edgecolor=BLACK, linewidth=0.6))
    axes.annotate("", (0.0, 3.0 * radius), (0.0, 0.0), arrowprops={"arrowstyle": "->"})
    axes.add_patch(Circle(center, reach, fill=False, edgecolor=GRAY, linewidth=0.6))
    axes.set(xlim=(-1.1 * reach, 1.1 * reach), ylim=(-1.1 * reach, 1.1 * reach))
    axes.set(xlabel="m to the right", ylabel="m ahead", aspect="equal")
    axes.legend(loc="lower right")
