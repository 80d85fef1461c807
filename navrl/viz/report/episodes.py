"""A recording as the plain numbers that the page's player draws."""

from __future__ import annotations

from typing import Any

import numpy as np

from navrl.evaluation.recording import Recording
from navrl.viz.animation import OUTCOME_WORDS, episode_name
from navrl.viz.scene import attention_scale, closest_step, scene_limits

_MILLIMETRES = 3  # decimals of lengths
_BEFORE_S = 1.0  # s before the end that its story looks back


def episode_data(name: str, recording: Recording) -> dict[str, Any]:
    """Return what the player needs, rounded, with world coordinates where it only draws.

    Args:
        name: For the list of episodes.
        recording: The episode.
    """
    limits = scene_limits(recording)
    return {
        "name": f"{name}: {episode_name(recording)}, {_ending(recording)}",
        "story": _story(recording),
        "outcome": recording.outcome,
        "time_step_s": recording.time_step_s,
        "robot_radius": recording.robot_radius,
        "goal_radius": recording.goal_radius,
        "max_range": recording.max_range,
        "limits": _rounded(np.array(limits)),
        "start_step": closest_step(recording),
        "walls": [_rounded(_corners(box)) for box in recording.walls],
        "path": _rounded(_without_repetition(recording.path)),
        "goal": _rounded(recording.goal),
        "pose": _rounded(recording.pose, 4),
        "people": [_people(boxes) for boxes in recording.pedestrian_boxes],
        "points": [_rounded(points) for points in _scan_points(recording)],
        "tagd": _tagd(recording),
        "action": _rounded(recording.action, 4),
        "rewards": {k: _rounded(v, 4) for k, v in recording.reward_terms.items()},
        "spatial": _weights(recording, "spatial"),
        "temporal": _weights(recording, "temporal"),
    }


def _weights(recording: Recording, name: str) -> dict[str, Any] | None:
    """Return attention and the weight at which its colours end; ``None`` if not recorded."""
    scale = attention_scale(recording, name)
    if scale is None:
        return None
    weights = getattr(recording, f"{name}_attention")
    return {"weights": _rounded(weights, 5), "full": round(float(scale.vmax), 5)}


def _tagd(recording: Recording) -> list[dict[str, Any]] | None:
    """Return the descriptors of each step and which of them are real in both halves."""
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
    if recording.points is not None:
        return recording.points
    stride = max(1, recording.ranges.shape[1] // 180)
    ranges = recording.ranges[:, ::stride]
    angle = 2 * np.pi * np.arange(0, recording.ranges.shape[1], stride) / recording.ranges.shape[1]
    return ranges[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _people(boxes: np.ndarray) -> list[list[list[float]]]:
    return [_rounded(_corners(box)) for box in boxes if np.isfinite(box).all()]


def _corners(box: np.ndarray) -> np.ndarray:
    cx, cy, hx, hy, yaw = box
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return np.array([[hx, hy], [-hx, hy], [-hx, -hy], [hx, -hy]]) @ turn + [cx, cy]


def _without_repetition(path: np.ndarray) -> np.ndarray:
    return path[np.append(True, (np.diff(path, axis=0) != 0).any(axis=1))]


# --- how it ended --------------------------------------------------------------------------------


def _ending(recording: Recording) -> str:
    return OUTCOME_WORDS.get(recording.outcome, recording.outcome)


def _story(recording: Recording) -> str:
    """Say in a sentence or two how the episode ended and what went before."""
    end = recording.num_steps
    seconds = end * recording.time_step_s
    story = f"{_ending(recording).capitalize()} after {seconds:.1f} s."
    if end < 1:
        return story
    speed = float(recording.action[-1, 0])
    turn = float(np.degrees(recording.action[-1, 1]))
    story += f" The last command was {speed:.2f} m/s and {turn:+.0f}°/s."
    before = max(0, end - round(_BEFORE_S / recording.time_step_s))
    distance, closing = _nearest(recording, end), _nearest(recording, before)
    if np.isfinite(distance) and before < end:
        back = (end - before) * recording.time_step_s
        story += (
            f" The nearest pedestrian's centre was {distance:.2f} m away, "
            f"{closing:.2f} m {back:.1f} s earlier."
        )
    return story


def _nearest(recording: Recording, step: int) -> float:
    offsets = recording.pedestrian_boxes[step, :, :2] - recording.pose[step, :2]
    distance = np.linalg.norm(offsets, axis=-1)
    return float(np.nanmin(distance)) if np.isfinite(distance).any() else float("nan")


def _rounded(values: np.ndarray, decimals: int = _MILLIMETRES) -> list:
    return np.round(np.asarray(values, dtype=np.float64), decimals).tolist()
