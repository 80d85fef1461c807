"""Boxes that cover the occupied cells of a map."""

from __future__ import annotations

import numpy as np


def boxes_of_cells(occupied: np.ndarray, origin: np.ndarray, cell: float) -> np.ndarray:
    """Cover cells by few axis-aligned boxes: runs along x, joined along y while they are equal.

    Args:
        occupied: ``[X, Y]`` bool.
        origin: ``[2]`` m, corner of the cell (0, 0).
        cell: Size of a cell, m.

    Returns:
        ``[R, 5]`` boxes (cx, cy, hx, hy, 0), m.

    Example:
        >>> boxes_of_cells(np.array([[True, True], [True, False]]), np.zeros(2), 1.0).tolist()
        [[1.0, 0.5, 1.0, 0.5, 0.0], [0.5, 1.5, 0.5, 0.5, 0.0]]
    """
    boxes: list[tuple[int, int, int, int]] = []
    open_runs: dict[tuple[int, int], int] = {}  # (first, stop) along x: first row
    for row in range(occupied.shape[1] + 1):
        runs = _runs(occupied[:, row]) if row < occupied.shape[1] else []
        for run in [run for run in open_runs if run not in runs]:
            boxes.append((run[0], open_runs.pop(run), run[1], row))
        for run in runs:
            open_runs.setdefault(run, row)
    corners = np.array(boxes, dtype=float).reshape(-1, 4)
    corners = corners[np.lexsort((corners[:, 0], corners[:, 1]))] * cell
    low, high = corners[:, :2] + origin, corners[:, 2:] + origin
    return np.column_stack([(low + high) / 2, (high - low) / 2, np.zeros(len(corners))])


def _runs(line: np.ndarray) -> list[tuple[int, int]]:
    """Return (first, stop) of the runs of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]]).astype(np.int8)))
    return [(int(first), int(stop)) for first, stop in edges.reshape(-1, 2)]
