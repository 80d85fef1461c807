"""Conversion of a recording to plain data for the report's player."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from navrl.evaluation.recording import Recording
from navrl.ops.contact import nearest_point_on_box
from navrl.viz.animation import episode_name
from navrl.viz.drive import forward_and_turn
from navrl.viz.outlines import pedestrian_outlines, wall_outlines
from navrl.viz.report.endings import ENDINGS, ending_of_recording, ending_of_row
from navrl.viz.scene import attention_scale, closest_step, scene_limits

_MILLIMETRES = 3  # decimals of lengths
_BEFORE_S = 1.0  # s before the end for the comparison in the description
_STRAIGHT_DEG = 10.0  # smaller angles are described as straight ahead
_DESCRIPTIONS = {
    "success": "The robot reached its goal after {seconds}.",
    "moved_into_pedestrian": "The robot moved into a pedestrian after {seconds}; contact was {at}.",
    "hit_by_pedestrian": "A pedestrian moved into the robot after {seconds}; contact was {at}.",
    "collision_pedestrian": "Robot and pedestrian touched after {seconds}; contact was {at}; "
    "the at-fault party was not recorded.",
    "collision_wall": "The robot hit a wall after {seconds}; contact was {at}.",
    "collision_furniture": "The robot hit a piece of furniture after {seconds}; contact was {at}.",
    "timeout": "The time limit was reached after {seconds}, {left:.2f} m before the goal.",
    "replay": "Replay of a log of {seconds}: the robot drove by its recorded commands; the "
    "policy's commands are those it would have given there.",
}


def episode_data(
    name: str, recording: Recording, row: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return the player's data, rounded, with world coordinates where possible.

    Args:
        name: Name in the list of episodes.
        recording: The episode.
        row: Row of ``episodes.csv``, with the at-fault party if an older recording lacks it.
    """
    limits = scene_limits(recording)
    ending = ending_of_recording(recording)
    if ending == "collision_pedestrian" and row is not None:
        ending = ending_of_row(row)
    label = ENDINGS.get(ending, (recording.outcome,))[0]
    return {
        "name": f"{name}: {episode_name(recording)}, {label}",
        "story": _description(recording, ending),
        "ending": label,
        "outcome": recording.outcome,
        "time_step_s": recording.time_step_s,
        "robot_radius": recording.robot_radius,
        "goal_radius": recording.goal_radius,
        "max_range": recording.max_range,
        "limits": _rounded(np.array(limits)),
        "start_step": closest_step(recording),
        "walls": [_rounded(outline) for outline in wall_outlines(recording)],
        "path": _rounded(_without_repetition(recording.path)),
        "goal": _rounded(recording.goal),
        "pose": _rounded(recording.pose, 4),
        "people": [
            [_rounded(outline) for outline in pedestrian_outlines(recording, step)]
            for step in range(len(recording.pedestrian_boxes))
        ],
        "points": [_rounded(points) for points in _scan_points(recording)],
        "tagd": _tagd(recording),
        "action": _rounded(forward_and_turn(recording), 4),
        "rewards": {k: _rounded(v, 4) for k, v in recording.reward_terms.items()},
        "spatial": _weights(recording, "spatial"),
        "temporal": _weights(recording, "temporal"),
    }


def _weights(recording: Recording, name: str) -> dict[str, Any] | None:
    """Return attention and the upper limit of its color scale; ``None`` if not recorded."""
    scale = attention_scale(recording, name)
    if scale is None:
        return None
    weights = getattr(recording, f"{name}_attention")
    return {"weights": _rounded(weights, 5), "full": round(float(scale.vmax), 5)}


def _tagd(recording: Recording) -> list[dict[str, Any]] | None:
    """Return the descriptors of each step and a mask of those with two valid centroids."""
    if recording.tagd is None:
        return None
    valid = recording.tagd_valid
    whole = np.ones(recording.tagd.shape[:2], bool) if valid is None else valid.all(axis=-1)
    return [
        {"vectors": _rounded(vectors), "valid": real.astype(int).tolist()}
        for vectors, real in zip(recording.tagd, whole, strict=True)
    ]


def _scan_points(recording: Recording) -> np.ndarray:
    """Return ``[T + 1, N, 2]`` m, robot frame: the pooled scan, or each 8th beam without one."""
    points, _ = recording.scan_points()
    return points if recording.points is not None else points[:, :: max(1, points.shape[1] // 180)]


def _without_repetition(path: np.ndarray) -> np.ndarray:
    return path[np.append(True, (np.diff(path, axis=0) != 0).any(axis=1))]


# --- how it ended --------------------------------------------------------------------------------


def _description(recording: Recording, ending: str) -> str:
    """Describe in a few sentences the end of the episode and what preceded it."""
    end = recording.num_steps
    seconds = f"{end * recording.time_step_s:.1f} s"
    left = float(np.linalg.norm(recording.goal - recording.pose[-1, :2]))
    story = _DESCRIPTIONS.get(ending, "{ending} after {seconds}.").format(
        seconds=seconds, left=left, ending=ending, at=_side_touched(recording)
    )
    if end < 1:
        return story
    speed, turn = forward_and_turn(recording)[-1].tolist()
    turn = float(np.degrees(turn))
    story += f" The last command was {speed:.2f} m/s and {turn:+.0f}°/s."
    before = max(0, end - round(_BEFORE_S / recording.time_step_s))
    distance, closing = _nearest(recording, end), _nearest(recording, before)
    if np.isfinite(distance) and before < end:
        back = (end - before) * recording.time_step_s
        story += (
            f" The nearest pedestrian's center was {distance:.2f} m away, "
            f"{closing:.2f} m {back:.1f} s earlier."
        )
    return story


def _side_touched(recording: Recording) -> str:
    """Return the direction of the box nearest to the robot at the end, relative to its heading."""
    static = recording.outcome == "collision_static"
    boxes = recording.walls if static else recording.pedestrian_boxes[-1]
    boxes = boxes[np.isfinite(boxes).all(axis=-1)]
    if not len(boxes):
        return "somewhere"
    x, y, yaw = recording.pose[-1].tolist()
    turns = zip(boxes[:, :4].tolist(), np.cos(boxes[:, 4]), np.sin(boxes[:, 4]), strict=True)
    points = [nearest_point_on_box(x, y, *box, cos, sin) for box, cos, sin in turns]
    nearest_x, nearest_y = min(points, key=lambda point: math.dist(point, (x, y)))
    angle = math.degrees(math.remainder(math.atan2(nearest_y - y, nearest_x - x) - yaw, math.tau))
    if abs(angle) < _STRAIGHT_DEG:
        return "straight ahead"
    side = "left" if angle > 0 else "right"
    return f"{abs(angle):.0f}° to the {side} of the robot's heading"


def _nearest(recording: Recording, step: int) -> float:
    offsets = recording.pedestrian_boxes[step, :, :2] - recording.pose[step, :2]
    distance = np.linalg.norm(offsets, axis=-1)
    return float(np.nanmin(distance)) if np.isfinite(distance).any() else float("nan")


def _rounded(values: np.ndarray, decimals: int = _MILLIMETRES) -> list:
    return np.round(np.asarray(values, dtype=np.float64), decimals).tolist()
