"""Top view of one step of a recorded episode, drawn to scale."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Circle, Polygon

from navrl.evaluation.recording import Recording
from navrl.viz.outlines import is_passed_under, pedestrian_outlines, wall_outlines
from navrl.viz.style import (
    BLACK,
    GRAY,
    GREEN,
    ORANGE,
    PURPLE,
    SPATIAL_COLORS,
    TEMPORAL_COLORS,
)

SPATIAL, TEMPORAL = "spatial", "temporal"
ATTENTIONS = {SPATIAL: SPATIAL_COLORS, TEMPORAL: TEMPORAL_COLORS}
TRAIL_S = 2.0  # s, duration of trails
VELOCITY_AHEAD_S = 1.0  # s; a velocity arrow ends at the predicted position after this time
_MARGIN_M = 0.15
_REACH_M = 12.0  # m from path and trajectory within which walls are shown
_MOVING_M_S = 0.05  # slower pedestrians are drawn as stationary


def draw_scene(
    axes: Axes,
    recording: Recording,
    step: int,
    attention: Sequence[str] = (),
    descriptors: bool = True,
) -> None:
    """Draw the world and the robot's observations before a decision.

    Walls, global path and goal, the robot and its trajectory, pedestrians with trails and
    velocities, the lidar's points, the motion c_{t-1} to c_t of each descriptor, and attention:
    blue on the sectors of the scan, red on rays to the descriptors.

    Args:
        axes: Axes to draw in; set to equal metric axes.
        recording: The episode.
        step: 0 to T; T is the end, which has no decision and no attention.
        attention: Any of ``"spatial"`` and ``"temporal"``; omitted if not recorded.
        descriptors: Whether to draw the TAGDs.

    Raises:
        ValueError: If ``step`` or ``attention`` is not allowed.

    Reference:
        Paper, figure of a scene with spatial (blue) and temporal attention (red).
    """
    if not 0 <= step <= recording.num_steps:
        raise ValueError(f"step={step}: must be between 0 and {recording.num_steps}")
    unknown = [name for name in attention if name not in ATTENTIONS]
    if unknown:
        raise ValueError(f"attention={unknown[0]!r}: must be one of {', '.join(ATTENTIONS)}")
    frame_scene(axes, recording)
    if SPATIAL in attention:
        _draw_spatial_attention(axes, recording, step)
    _draw_map(axes, recording)
    if TEMPORAL in attention:
        _draw_temporal_attention(axes, recording, step)
    _draw_scan(axes, recording, step)
    _draw_pedestrians(axes, recording, step)
    _draw_robot(axes, recording, step)
    if descriptors:
        _draw_descriptors(axes, recording, step)


def frame_scene(axes: Axes, recording: Recording) -> None:
    """Set equal metric axes with limits for the whole episode."""
    x, y = scene_limits(recording)
    axes.set(xlim=x, ylim=y, xlabel="x in m", ylabel="y in m")
    axes.set_aspect("equal")


def attention_scale(recording: Recording, name: str) -> Normalize | None:
    """Return the color scale of all steps of an episode.

    Its upper limit is the median of the steps' largest weights, so that one extreme step does not
    make all others pale and different steps look different.

    Args:
        recording: The episode.
        name: ``"spatial"`` or ``"temporal"``.

    Returns:
        The scale, or ``None`` if that attention was not recorded.
    """
    weights = getattr(recording, f"{name}_attention")
    return None if weights is None else Normalize(0.0, float(np.median(weights.max(axis=1))))


def scene_limits(recording: Recording) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return x and y limits in m around walls, path and trajectory.

    Walls far from path and trajectory, as on large maps, are outside of the limits.
    """
    corners = wall_outlines(recording)
    route = np.concatenate([recording.path, recording.pose[:, :2], [recording.goal]])
    points = np.concatenate([*corners, route])
    low = np.maximum(points.min(axis=0), route.min(axis=0) - _REACH_M) - _MARGIN_M
    high = np.minimum(points.max(axis=0), route.max(axis=0) + _REACH_M) + _MARGIN_M
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def closest_step(recording: Recording) -> int:
    """Return the step with the minimum distance to a pedestrian; the middle one without any."""
    offsets = recording.pedestrian_boxes[:-1, :, :2] - recording.pose[:-1, None, :2]
    distance = np.linalg.norm(offsets, axis=-1)
    if np.isnan(distance).all():
        return recording.num_steps // 2
    return int(np.nanargmin(distance) // distance.shape[1])


# --- layers, from the lowest ---------------------------------------------------------------------


def _draw_map(axes: Axes, recording: Recording) -> None:
    outlines, above = wall_outlines(recording), is_passed_under(recording)
    walls = [outline for outline, is_above in zip(outlines, above, strict=True) if not is_above]
    axes.add_collection(PolyCollection(walls, facecolors="#4D4D4D", zorder=2))
    if above.any():  # table tops
        tops = [outline for outline, is_above in zip(outlines, above, strict=True) if is_above]
        look = {"facecolors": "#4D4D4D22", "edgecolors": GRAY, "linewidths": 0.6, "zorder": 1.9}
        axes.add_collection(PolyCollection(tops, **look))
    axes.plot(*recording.path.T, color=GRAY, linestyle="--", linewidth=1.0, zorder=2.1)
    goal = Circle(recording.goal, recording.goal_radius, fill=False, edgecolor=GREEN)
    goal.set(linewidth=1.2, zorder=2.2)
    axes.add_patch(goal)


def _draw_spatial_attention(axes: Axes, recording: Recording, step: int) -> None:
    if recording.spatial_attention is None or step == recording.num_steps:
        return
    weights, pose = recording.spatial_attention[step], recording.pose[step]
    rims = _sector_rims(recording.beam_ends()[step], len(weights))
    sectors = [_to_world(pose, np.concatenate([np.zeros((1, 2)), rim])) for rim in rims]
    axes.add_collection(
        PolyCollection(
            sectors,
            array=weights,
            cmap=SPATIAL_COLORS,
            norm=attention_scale(recording, SPATIAL),
            alpha=0.8,
            edgecolors="white",
            linewidths=0.3,
            zorder=1.5,
        )
    )


def _draw_temporal_attention(axes: Axes, recording: Recording, step: int) -> None:
    weights, tagd = recording.temporal_attention, recording.tagd
    if weights is None or tagd is None or step == recording.num_steps:
        return
    pose, scale = recording.pose[step], attention_scale(recording, TEMPORAL)
    ends = _to_world(pose, tagd[step, :, 2:])
    order = np.argsort(weights[step])  # largest weights on top
    rays = np.stack([np.broadcast_to(pose[:2], ends.shape), ends], axis=1)[order]
    share = np.clip(scale(weights[step][order]), 0.0, 1.0)
    axes.add_collection(
        LineCollection(
            rays,
            array=weights[step][order],
            cmap=TEMPORAL_COLORS,
            norm=scale,
            linewidths=0.6 + 2.0 * share,
            capstyle="round",
            zorder=2.5,
        )
    )


def _draw_scan(axes: Axes, recording: Recording, step: int) -> None:
    points, returned = (values[step] for values in recording.scan_points())
    world = _to_world(recording.pose[step], points[returned])
    axes.plot(*world.T, ".", color=BLACK, markersize=1.8, zorder=4)


def _draw_pedestrians(axes: Axes, recording: Recording, step: int) -> None:
    boxes = recording.pedestrian_boxes
    first = max(0, step - round(TRAIL_S / recording.time_step_s))
    # A contact ends the last step early: its displacement would give too low velocities.
    now = min(max(step, 1), max(recording.num_steps - 1, 1))
    now = min(now, recording.num_steps)  # no velocity at the start of an episode
    velocity = (boxes[now, :, :2] - boxes[max(now - 1, 0), :, :2]) / recording.time_step_s
    present = np.isfinite(boxes[step, :, 0])
    moving = present & (np.linalg.norm(velocity, axis=-1) > _MOVING_M_S)
    for k in np.flatnonzero(moving):
        axes.plot(*boxes[first : step + 1, k, :2].T, color=ORANGE, alpha=0.5, zorder=3)
    look = {"facecolor": ORANGE, "edgecolor": BLACK, "linewidth": 0.6, "zorder": 3.1}
    axes.add_collection(PolyCollection(pedestrian_outlines(recording, step), **look))
    _arrows(axes, boxes[step, moving, :2], velocity[moving] * VELOCITY_AHEAD_S, ORANGE, 3.2)


def _draw_robot(axes: Axes, recording: Recording, step: int) -> None:
    x, y, yaw = recording.pose[step]
    radius = recording.robot_radius
    axes.plot(*recording.pose[: step + 1, :2].T, color=PURPLE, linewidth=1.4, zorder=5)
    disc = Circle((x, y), radius, facecolor=PURPLE, edgecolor=BLACK, linewidth=0.6, zorder=5.1)
    axes.add_patch(disc)
    nose = radius * np.array([[1.0, 0.0], [-0.5, 0.6], [-0.5, -0.6]])
    heading = Polygon(_to_world((x, y, yaw), nose), facecolor=BLACK, linewidth=0, zorder=5.2)
    axes.add_patch(heading)


def _draw_descriptors(axes: Axes, recording: Recording, step: int) -> None:
    if recording.tagd is None:
        return
    tagd, pose = recording.tagd[step], recording.pose[step]
    if recording.tagd_valid is not None:  # a half that is filled in claims no motion
        tagd = tagd[recording.tagd_valid[step].all(axis=-1)]
    before, now = _to_world(pose, tagd[:, :2]), _to_world(pose, tagd[:, 2:])
    _arrows(axes, before, now - before, GREEN, 6)


def _arrows(axes: Axes, start: np.ndarray, vector: np.ndarray, color: str, zorder: float) -> None:
    if len(start):
        axes.quiver(
            *start.T,
            *vector.T,
            color=color,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            units="inches",
            width=1.2 / 72,
            headwidth=4.5,
            headlength=4.5,
            headaxislength=4.0,
            minlength=0.5,
            zorder=zorder,
        )


# --- geometry ------------------------------------------------------------------------------------


def _to_world(pose: Sequence[float], points: np.ndarray) -> np.ndarray:
    x, y, yaw = pose
    cos, sin = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[cos, sin], [-sin, cos]]) + np.array([x, y])


def _sector_rims(ends: np.ndarray, count: int) -> list[np.ndarray]:
    """Return the outer edges ``[n, 2]`` of equal sectors, starting straight ahead.

    Args:
        ends: ``[beams, 2]`` m, robot frame.
        count: Number of sectors.
    """
    bearing = np.arctan2(ends[:, 1], ends[:, 0])
    beam = np.mod(bearing * len(ends) / (2 * np.pi) + 0.5, len(ends))  # 0.5: beam 0 is in sector 0
    order = np.argsort(beam)
    radius, bearing = np.linalg.norm(ends, axis=-1)[order], (beam[order] - 0.5) * 2 * np.pi
    bearing /= len(ends)
    edges = np.linspace(0, len(ends), count + 1).round()
    rims = []
    for first, last in pairwise(np.searchsorted(beam[order], edges)):
        border = 2 * np.pi * edges[len(rims) + 1] / len(ends)
        # The sector's last beam extends to the border, so that there are no gaps.
        angle, reach = np.append(bearing[first:last], border), radius[first:last]
        reach = np.append(reach, reach[-1:] if last > first else 0.0)
        rims.append(reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    return rims
