"""Preparation of planned paths for a policy."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from navrl.checks import checked_numbers
from navrl.worlds.scenario import MAX_PATH_POINTS

_FIRST_TOLERANCE_M = 0.01  # of the first simplification, doubled until the path is short enough
_BRANCH_TOLERANCE_M = 0.3  # a branch as near as the nearest one, by pose errors and lane widths


def checked_path(path: ArrayLike, max_points: int | None = None) -> np.ndarray:
    """Return a path as ``[P, 2]`` float64.

    Args:
        path: ``[P, 2]`` m.
        max_points: Largest number of points; None for any.

    Raises:
        ValueError: If the shape is wrong or a point is not finite.
    """
    points = checked_numbers("path", path, "[P, 2] numbers (m)")
    limit = np.inf if max_points is None else max_points
    if points.ndim != 2 or points.shape[1] != 2 or not 1 <= len(points) <= limit:
        number = "at least 1" if max_points is None else f"from 1 to {max_points}"
        raise ValueError(f"path.shape={list(points.shape)}: must be [P, 2] with P {number}")
    if not np.isfinite(points).all():
        raise ValueError("path: must be finite in all points")
    return points


def simplified_path(path: ArrayLike, max_points: int = MAX_PATH_POINTS) -> np.ndarray:
    """Return a path with at most ``max_points`` points, close to the given one.

    Points that deviate least are dropped (Douglas-Peucker); 1 cm suffices for most planners' paths.

    Args:
        path: ``[P, 2]`` m, of any length.
        max_points: Largest number of points, at least 2.

    Returns:
        ``[P', 2]`` float64 m with the same first and last point; the path itself if it is short.

    Raises:
        ValueError: If the shape is wrong or a point is not finite.

    Example:
        >>> simplified_path([(0.01 * i, 0.0) for i in range(301)]).tolist()
        [[0.0, 0.0], [3.0, 0.0]]
    """
    points = checked_path(path)
    if len(points) <= max_points:
        return points.copy()
    from skimage.measure import approximate_polygon  # imported for long paths only

    tolerance, shifted = _FIRST_TOLERANCE_M, points - points[0]
    while True:
        short = approximate_polygon(shifted, tolerance)
        if len(short) <= max_points:
            return short + points[0]
        tolerance *= 2.0


def start_progress(path: np.ndarray, position: np.ndarray) -> float:
    """Return the arc length at which a robot starts a path that may pass it more than once.

    Of the branches that are about as near as the nearest one, it is the first.

    Args:
        path: ``[P, 2]`` m.
        position: ``[2]`` m, same frame.

    Returns:
        Arc length of the robot's projection, m.

    Example:
        >>> loop = np.array([(0, 0), (4, 0), (4, 4), (0, 4), (0, -1)])  # passes its start
        >>> start_progress(loop, np.array([0.1, 0.05]))
        0.1
    """
    steps = np.diff(path, axis=0)
    lengths = np.hypot(*steps.T)
    steps, starts = steps[lengths > 0.0], path[:-1][lengths > 0.0]
    lengths = lengths[lengths > 0.0]
    if len(lengths) == 0:
        return 0.0
    offsets = position - starts
    along = np.clip((offsets * steps).sum(-1) / lengths, 0.0, lengths)
    gaps = np.hypot(*(offsets - steps * (along / lengths)[:, None]).T)
    index = int(np.argmax(gaps <= gaps.min() + _BRANCH_TOLERANCE_M))
    while index + 1 < len(gaps) and gaps[index + 1] <= gaps[index]:
        index += 1
    return float(lengths[:index].sum() + along[index])
