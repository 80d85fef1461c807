"""Figure of the computation of TAGDs in five steps and a close-up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrow, Patch

from navrl.evaluation.recording import Recording
from navrl.viz.animation import episode_name
from navrl.viz.legend import ArrowHandler
from navrl.viz.style import (
    BLACK,
    BLUE,
    GRAY,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILLION,
    plain_text,
    save_figure,
    style,
)

_NOW, _BEFORE, _CENTER = BLUE, ORANGE, GREEN
_CLOSE_UP_M = 0.55  # half the width of the close-up
_STATIONARY_M = 0.02  # less is noise and too short for an arrow
_NO_RETURN = 1e-3  # m short of the maximum range
_TOLERANCE_RAD = 1e-6


def save_tagd(
    recording: Recording,
    file: str | Path,
    step: int | None = None,
    group_radius: float = 0.25,
    policy: str | None = None,
) -> Path:
    """Draw the computation of descriptors from two scans, as in the paper's schematic.

    1. Both scans in their own robot frames; 2. the earlier one aligned by ICP; 3. a center on each
       ray
    at its sector's nearest return; 4. the groups around the centers; 5. the centroids of both times
    and the motion between them. The sixth panel enlarges the descriptor with the largest motion.

    Args:
        recording: Episode with TAGDs.
        file: ``.png``, ``.svg`` or ``.pdf``.
        step: 1 to T. The one that shows a moving pedestrian best if ``None``.
        group_radius: Distance d_thresh within which points belong to a center, m.
        policy: Name of the policy, for the headline.

    Returns:
        The file.

    Raises:
        ValueError: If the episode has no TAGDs, or ``step`` is out of range.

    Reference:
        Paper Sec. IV-A, Algorithm 1 and the figure of the TAGD generation process.
    """
    if recording.tagd is None or recording.points is None or recording.points_aligned is None:
        raise ValueError("recording: has no TAGDs; must be of a policy with TAGDs in its pipeline")
    step = _step_of_largest_motion(recording) if step is None else step
    if not 1 <= step <= recording.num_steps:
        raise ValueError(f"step={step}: must be between 1 and {recording.num_steps}")
    stage = _Stage(recording, step, group_radius)
    with style():
        figure = Figure((11.0, 7.4), layout="constrained")
        panels = list(figure.subplots(2, 3).flat)
        for axes, draw in zip(panels, _PANELS, strict=True):
            draw(axes, stage)
            axes.set_aspect("equal")
            axes.set(xlabel="x in m, robot frame", ylabel="y in m, robot frame")
        seconds = step * recording.time_step_s
        title = f"{episode_name(recording, policy)}: from two scans to descriptors, t = "
        figure.suptitle(plain_text(f"{title}{seconds:.1f} s"), fontsize=10)
        figure.legend(
            handles=_handles(),
            handler_map={FancyArrow: ArrowHandler()},
            loc="outside lower center",
            ncols=4,
        )
        return save_figure(figure, file)


class _Stage:
    """Points of one step, robot frame at t."""

    def __init__(self, recording: Recording, step: int, group_radius: float) -> None:
        self.max_range, self.group_radius = recording.max_range, group_radius
        self.robot_radius = recording.robot_radius
        self.now = _returned(recording.points[step], recording.max_range)
        self.before = _returned(recording.points[step - 1], recording.max_range)
        # Alignment preserves the order of points, so the earlier scan has the mask of returns.
        hit = _is_return(recording.points[step - 1], recording.max_range)
        self.aligned = recording.points_aligned[step][hit]
        tagd = recording.tagd[step]
        self.centers = group_centers(self.now, len(tagd), recording.max_range)
        self.previous_centroids, self.centroids = tagd[:, :2], tagd[:, 2:]
        valid = recording.tagd_valid
        self.valid = np.ones(len(tagd), bool) if valid is None else valid[step].all(axis=-1)

    @property
    def motion(self) -> np.ndarray:
        """Motion of descriptors ``[N_c]`` m, zero without two valid centroids."""
        moved = np.linalg.norm(self.centroids - self.previous_centroids, axis=-1)
        return np.where(self.valid, moved, 0.0)

    @property
    def used(self) -> np.ndarray:
        """Mask ``[N_c]`` of centers with a return."""
        return np.linalg.norm(self.centers, axis=-1) < self.max_range - _NO_RETURN


def group_centers(points: np.ndarray, count: int, max_range: float) -> np.ndarray:
    """Return the group centers ``[count, 2]`` m, on each ray at its sector's nearest return.

    Args:
        points: ``[n, 2]`` m, returns, robot frame.
        count: Number of rays N_c.
        max_range: Distance of a center without return, m.
    """
    angle = 2 * np.pi * np.arange(count) / count
    offset = np.arctan2(points[:, 1], points[:, 0])[None] - angle[:, None]
    offset = np.abs((offset + np.pi) % (2 * np.pi) - np.pi)
    inside = offset <= np.pi / count + _TOLERANCE_RAD
    distance = np.where(inside, np.linalg.norm(points, axis=-1), max_range)
    nearest = np.minimum(distance.min(axis=1, initial=max_range), max_range)
    return nearest[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


# --- panels --------------------------------------------------------------------------------------


def _draw_two_scans(axes: Axes, stage: _Stage) -> None:
    _frame(axes, stage, "1. two scans, each where the robot saw it")
    _dots(axes, stage.before, _BEFORE)
    _dots(axes, stage.now, _NOW)


def _draw_aligned(axes: Axes, stage: _Stage) -> None:
    _frame(axes, stage, "2. the earlier scan aligned by ICP")
    _dots(axes, stage.aligned, _BEFORE)
    _dots(axes, stage.now, _NOW)


def _draw_centers(axes: Axes, stage: _Stage) -> None:
    _frame(axes, stage, "3. a center on each ray, at the nearest return")
    rays = np.stack([np.zeros_like(stage.centers), stage.centers], axis=1)
    axes.add_collection(LineCollection(rays, colors=GRAY, linewidths=0.5, zorder=1))
    _dots(axes, stage.now, _NOW)
    axes.plot(*stage.centers[stage.used].T, "+", color=_CENTER, markersize=6, zorder=5)


def _draw_groups(axes: Axes, stage: _Stage) -> None:
    _frame(axes, stage, "4. groups: points near a center")
    _group_circles(axes, stage)
    for points, color in ((stage.aligned, _BEFORE), (stage.now, _NOW)):
        _dots(axes, points, "#C8C8C8")
        _dots(axes, points[_grouped(points, stage)], color)


def _draw_descriptors(axes: Axes, stage: _Stage) -> None:
    _frame(axes, stage, "5. centroids, and the motion they show")
    _dots(axes, stage.now, "#C8C8C8")
    _centroids(axes, stage, 3.5)
    _arrows(axes, stage)


def _draw_close_up(axes: Axes, stage: _Stage) -> None:
    largest = int(stage.motion.argmax())
    middle = stage.centers[largest]
    moved = stage.motion[largest]
    axes.set_title(f"enlarged: descriptor {largest} moves {100 * moved:.0f} cm")
    _group_circles(axes, stage)
    _dots(axes, stage.aligned, _BEFORE, 5.0)
    _dots(axes, stage.now, _NOW, 5.0)
    axes.plot(*stage.centers[stage.used].T, "+", color=_CENTER, markersize=9, zorder=5)
    _centroids(axes, stage, 8.0)
    _arrows(axes, stage)
    axes.set_xlim(middle[0] - _CLOSE_UP_M, middle[0] + _CLOSE_UP_M)
    axes.set_ylim(middle[1] - _CLOSE_UP_M, middle[1] + _CLOSE_UP_M)


_PANELS = (
    _draw_two_scans,
    _draw_aligned,
    _draw_centers,
    _draw_groups,
    _draw_descriptors,
    _draw_close_up,
)


# --- parts ---------------------------------------------------------------------------------------


def _frame(axes: Axes, stage: _Stage, title: str) -> None:
    points = np.concatenate([stage.now, stage.before, stage.aligned, [[0.0, 0.0]]])
    (left, bottom), (right, top) = points.min(axis=0) - 0.3, points.max(axis=0) + 0.3
    axes.set(title=title, xlim=(left, right), ylim=(bottom, top))
    axes.add_patch(Circle((0, 0), stage.robot_radius, color=PURPLE, zorder=4))
    axes.plot([0, 1.6 * stage.robot_radius], [0, 0], color=BLACK, linewidth=1.2, zorder=4.1)


def _dots(axes: Axes, points: np.ndarray, color: str, size: float = 2.4) -> None:
    axes.plot(*points.T, ".", color=color, markersize=size, zorder=3)


def _group_circles(axes: Axes, stage: _Stage) -> None:
    circles = [Circle(center, stage.group_radius) for center in stage.centers[stage.used]]
    axes.add_collection(
        PatchCollection(circles, facecolor="none", edgecolor=_CENTER, linewidth=0.7, zorder=2)
    )


def _grouped(points: np.ndarray, stage: _Stage) -> np.ndarray:
    centers = stage.centers[stage.used]
    distance = np.linalg.norm(points[:, None] - centers[None], axis=-1)
    return (distance <= stage.group_radius).any(axis=1)


def _centroids(axes: Axes, stage: _Stage, size: float) -> None:
    look = {"linestyle": "", "markeredgecolor": BLACK, "markeredgewidth": 0.4, "zorder": 6}
    before, now = stage.previous_centroids[stage.valid], stage.centroids[stage.valid]
    axes.plot(*before.T, marker="s", color=_BEFORE, markersize=size, **look)
    axes.plot(*now.T, marker="o", color=_NOW, markersize=size, **look)


def _arrows(axes: Axes, stage: _Stage) -> None:
    moves = stage.motion > _STATIONARY_M
    start = stage.previous_centroids[moves]
    axes.quiver(
        *start.T,
        *(stage.centroids[moves] - start).T,
        color=VERMILLION,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        units="inches",
        width=1.6 / 72,
        headwidth=4.0,
        headlength=4.0,
        headaxislength=3.5,
        zorder=7,
    )


def _handles() -> list[Line2D | Patch]:
    square = {"linestyle": "", "markeredgecolor": BLACK, "markeredgewidth": 0.4, "markersize": 5}
    return [
        Patch(facecolor=PURPLE, label="robot, its front to the right"),
        Line2D([], [], color=_BEFORE, linestyle="", marker=".", label="scan at t-1"),
        Line2D([], [], color=_NOW, linestyle="", marker=".", label="scan at t"),
        Line2D([], [], color=_CENTER, linestyle="", marker="+", label="center $g_i$"),
        Line2D(
            [],
            [],
            linestyle="",
            marker="o",
            markerfacecolor="none",
            markeredgecolor=_CENTER,
            markersize=9,
            label="group, within $d_{thresh}$ of its center",
        ),
        Line2D([], [], color=_BEFORE, marker="s", label="centroid $c_{t-1}$", **square),
        Line2D([], [], color=_NOW, marker="o", label="centroid $c_t$", **square),
        FancyArrow(0, 0, 1, 0, color=VERMILLION, label="motion from $c_{t-1}$ to $c_t$"),
    ]


def _is_return(points: np.ndarray, max_range: float) -> np.ndarray:
    return np.linalg.norm(points, axis=-1) < max_range - _NO_RETURN


def _returned(points: np.ndarray, max_range: float) -> np.ndarray:
    return points[_is_return(points, max_range)]


def _step_of_largest_motion(recording: Recording) -> int:
    """Return the step with the largest motion of a pedestrian's descriptor above the others."""
    best, chosen = -np.inf, 1
    for step in range(1, recording.num_steps + 1):
        boxes, earlier = recording.pedestrian_boxes[step], recording.pedestrian_boxes[step - 1]
        walks = np.linalg.norm(boxes[:, :2] - earlier[:, :2], axis=-1) > 0.05
        if not walks.any():
            continue
        x, y, yaw = recording.pose[step]
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        people = (boxes[walks, :2] - [x, y]) @ turn
        stage = _Stage(recording, step, 0.0)
        near = np.linalg.norm(stage.centroids[:, None] - people[None], axis=-1).min(axis=1) < 0.4
        if not near.any():
            continue
        # Static objects move by ICP's error: steps with a large error are unsuitable.
        missed = float(stage.motion[~near].max(initial=0.0))
        beyond = float(stage.motion[near].max()) - missed
        if beyond > best:
            best, chosen = beyond, step
    return chosen
