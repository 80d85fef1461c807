"""Golden drives: recorded sensor values and the commands that follow from them."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from navrl import keys
from navrl.deploy import PolicyRunner

_RANGE_STEP = 1e-3  # m, so that ranges take two bytes


def record(
    runner: PolicyRunner,
    drives: Sequence[Mapping[str, np.ndarray]],
    sensors: Sequence[str],
    num_steps: int,
) -> dict[str, np.ndarray]:
    """Return the sensor values of drives in a row and the runner's commands.

    Args:
        runner: Runner of the policy; it is reset before each drive.
        drives: ``ranges`` ``[T, beams]`` m, ``pose`` ``[T, 3]``, ``path`` ``[P, 2]``, and the
            optional ``velocity`` ``[T, C]``, of each drive.
        sensors: Keys of the values to return.
        num_steps: Steps to record in total.

    Returns:
        The sensors ``[T, ...]``, ``ranges_mm`` in place of ``ranges``, ``path`` ``[K, P, 2]`` of K
        drives, ``drive`` ``[T]`` int64, the index of each step's drive, and ``command`` ``[T, C]``.
    """
    found: dict[str, list] = {"ranges_mm": [], "drive": [], "command": []}
    found |= {key: [] for key in sensors if key not in (keys.RANGES, keys.PATH)}
    for index, drive in enumerate(drives):
        runner.reset()
        for step in range(len(drive[keys.POSE])):
            ranges_mm = np.rint(drive[keys.RANGES][step] / _RANGE_STEP).astype(np.uint16)
            velocity = drive[keys.VELOCITY][step].astype(np.float32)
            pose = drive[keys.POSE][step].astype(np.float64)
            scan_motion = np.zeros((2, 3), np.float32)
            given = {keys.POSE: pose, keys.VELOCITY: velocity, keys.SCAN_MOTION: scan_motion}
            ranges = meters(ranges_mm)
            command = runner.act(ranges, pose, drive[keys.PATH], velocity, scan_motion)
            given |= {"ranges_mm": ranges_mm, "drive": index, "command": command}
            for key, values in found.items():
                values.append(given[key])
    arrays = {key: np.array(values[:num_steps]) for key, values in found.items()}
    return arrays | {keys.PATH: np.stack([padded(drive[keys.PATH]) for drive in drives])}


def meters(ranges_mm: np.ndarray) -> np.ndarray:
    """Return ranges in m, float32.

    Example:
        >>> meters(np.array([3500], dtype=np.uint16))
        array([3.5], dtype=float32)
    """
    return ranges_mm.astype(np.float32) / np.float32(1.0 / _RANGE_STEP)


def padded(path: np.ndarray, num_points: int = 200) -> np.ndarray:
    """Return a path ``[num_points, 2]`` float64 that repeats its last point.

    Example:
        >>> padded(np.zeros((2, 2))).shape
        (200, 2)
    """
    path = np.asarray(path, dtype=np.float64)
    return np.concatenate([path, np.repeat(path[-1:], num_points - len(path), axis=0)])


def pack(arrays: Mapping[str, np.ndarray]) -> str:
    """Return arrays as text, for the metadata of an ONNX file."""
    stream = io.BytesIO()
    values: dict[str, Any] = {key: np.asarray(value) for key, value in arrays.items()}
    np.savez_compressed(stream, **values)
    return base64.b64encode(stream.getvalue()).decode("ascii")
