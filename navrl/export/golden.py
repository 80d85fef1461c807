"""Golden drives: recorded sensor values and the commands that follow from them."""

from __future__ import annotations

import base64
import copy
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from navrl import keys
from navrl.deploy import PolicyRunner
from navrl.export.onnx_policy import TOLERANCE

_RANGE_STEP = 1e-3  # m, so that ranges take two bytes
_NUDGE = 1e-6  # m; float32 resolves 2.4e-7 m at 3.5 m
_NUDGED = 8  # runners with such scans; each crosses a threshold with a probability of one half


def record(
    runner: PolicyRunner,
    drives: Iterable[Mapping[str, np.ndarray]],
    sensors: Sequence[str],
    num_steps: int,
) -> dict[str, np.ndarray]:
    """Return the sensor values of drives in a row and the runner's commands.

    A drive ends before a step at which the command changes by more than the tolerance of a file if
    the scans change by a millionth of a meter, e.g. where ICP just stops, a shield just replaces a
    command, or a network is steep: there the rounding of another engine or processor decides, and a
    difference says nothing about the file.

    Args:
        runner: Runner of the policy; it is reset before each drive.
        drives: ``ranges`` ``[T, beams]`` m, ``pose`` ``[T, 3]``, ``path`` ``[P, 2]``, and
            ``velocity`` ``[T, C]``, of each drive; taken until there are enough steps.
        sensors: Keys of the values to return.
        num_steps: Steps to record in total.

    Returns:
        The sensors ``[T, ...]``, ``ranges_mm`` in place of ``ranges``, ``path`` ``[K, P, 2]`` of K
        drives, ``drive`` ``[T]`` int64, the index of each step's drive, and ``command`` ``[T, C]``.

    Raises:
        ValueError: If the drives have fewer steps.
    """
    found: dict[str, list] = {"ranges_mm": [], "drive": [], "command": []}
    found |= {key: [] for key in sensors if key not in (keys.RANGES, keys.PATH)}
    paths: list[np.ndarray] = []
    nudged = [copy.deepcopy(runner) for _ in range(_NUDGED)]
    generator = np.random.default_rng(0)
    for index, drive in enumerate(drives):
        if len(found["drive"]) >= num_steps:
            break
        paths.append(padded(drive[keys.PATH]))
        for each in (runner, *nudged):
            each.reset()
        for given in _steps(drive):
            scan, others = meters(given["ranges_mm"]), _others(given, drive)
            command = runner.act(scan, *others)
            if _jumps(nudged, scan, others, command, generator):
                break
            given |= {"drive": index, "command": command}
            for key, values in found.items():
                values.append(given[key])
    if len(found["drive"]) < num_steps:
        raise ValueError(
            f"golden_steps={num_steps}: must be at most {len(found['drive'])}, the steps of the "
            "drives before commands that jump"
        )
    arrays = {key: np.array(values[:num_steps]) for key, values in found.items()}
    return arrays | {keys.PATH: np.stack(paths)}


def _steps(drive: Mapping[str, np.ndarray]) -> Iterator[dict[str, Any]]:
    """Yield the sensor values of each step of a drive."""
    for step in range(len(drive[keys.POSE])):
        yield {
            "ranges_mm": np.rint(drive[keys.RANGES][step] / _RANGE_STEP).astype(np.uint16),
            keys.POSE: drive[keys.POSE][step].astype(np.float64),
            keys.VELOCITY: drive[keys.VELOCITY][step].astype(np.float32),
            keys.SCAN_MOTION: np.zeros((2, 3), np.float32),
        }


def _jumps(
    nudged: Sequence[PolicyRunner],
    scan: np.ndarray,
    others: Sequence[np.ndarray],
    command: np.ndarray,
    generator: np.random.Generator,
) -> bool:
    """Return whether runners with almost the same scan give another command."""
    shifts = generator.uniform(-_NUDGE, _NUDGE, (len(nudged), len(scan)))
    near = [each.act(scan + shift, *others) for each, shift in zip(nudged, shifts, strict=True)]
    return bool(np.abs(np.array(near) - command).max() > TOLERANCE)


def _others(given: Mapping[str, Any], drive: Mapping[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """Return the arguments of a step after its scan."""
    return given[keys.POSE], drive[keys.PATH], given[keys.VELOCITY], given[keys.SCAN_MOTION]


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
