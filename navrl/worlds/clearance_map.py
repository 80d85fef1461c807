"""Global paths among oriented boxes and discs, planned by a cost near obstacles."""

from __future__ import annotations

import math

import numpy as np
from skimage.graph import MCP_Geometric
from skimage.measure import label

from navrl.checks import check_positive
from navrl.worlds.planner import NoPathError, resample
from navrl.worlds.scenario import MAX_PATH_POINTS

_SMOOTHING_M = (0.8, 0.4, 0.2)  # lengths of the moving average, the first that is clear is used


class ClearanceMap:
    """Distances to obstacles on a grid, and paths that keep away from obstacles.

    A path may be as close to obstacles as ``clearance``, and a cell nearer than ``comfort`` costs
    up to ``1 + weight`` times its length. So a path goes through the middle of a doorway without
    an inflation that would close the doorway or press the whole path to one side of a room.

    Args:
        boxes: ``[W, 5]`` boxes with any yaw, m and rad.
        discs: ``[D, 3]`` discs, m.
        clearance: Minimum distance of the path to obstacles, m: the robot's radius and a margin.
        comfort: Distance from which on a cell costs nothing extra, m.
        weight: Extra cost at ``clearance``.
        cell: Size of a grid cell, m.
        margin: Free space around the obstacles, m.
        is_tight: Whether ``margin`` counts from the obstacles' sides, for obstacles around which
            there is nothing to plan; otherwise from the circles around them.

    Raises:
        ValueError: If there are no obstacles, a value is not positive or ``comfort`` not larger
            than ``clearance``.

    Example:
        >>> room = np.array([[0, 2, 3, 0.05, 0], [0, -2, 3, 0.05, 0], [0, 0, 0.5, 0.5, 0.785]])
        >>> path = ClearanceMap(room, np.zeros((0, 3))).path([-2.5, 0.0], [2.5, 0.0])
        >>> bool(np.abs(path[:, 1]).max() > 0.9)  # around the turned box
        True
    """

    def __init__(
        self,
        boxes: np.ndarray,
        discs: np.ndarray,
        clearance: float = 0.23,
        comfort: float = 0.6,
        weight: float = 3.0,
        cell: float = 0.05,
        margin: float = 1.0,
        is_tight: bool = False,
    ) -> None:
        """Compute the clearance of all cells."""
        check_positive(clearance=clearance, weight=weight, cell=cell, margin=margin)
        if not comfort > clearance:
            raise ValueError(f"comfort={comfort}: must be > clearance={clearance} m")
        if not len(boxes) + len(discs):
            raise ValueError("boxes=[], discs=[]: must have at least one obstacle")
        self.boxes, self.discs = np.asarray(boxes, float), np.asarray(discs, float)
        self.min_clearance, self.comfort, self.weight, self.cell = clearance, comfort, weight, cell
        radius = np.concatenate([np.linalg.norm(self.boxes[:, 2:4], axis=1), self.discs[:, 2]])
        self._centers = center = np.concatenate([self.boxes[:, :2], self.discs[:, :2]])
        self._extents = _extents(self.boxes, self.discs)
        reach = self._extents if is_tight else radius[:, None]
        self.origin = (center - reach).min(0) - margin
        size = (center + reach).max(0) + margin - self.origin
        self.clearance = np.full(tuple(np.ceil(size / cell).astype(int)), float(comfort))
        for index in range(len(center)):
            self._lower(index)
        self._searches: dict[int, tuple[np.ndarray, MCP_Geometric]] = {}
        self.regions = np.asarray(label(self.clearance >= clearance, connectivity=1))

    def _lower(self, index: int) -> None:
        """Lower the clearance of the cells around an obstacle to their distance from it."""
        center, reach = self._centers[index], self._extents[index] + self.comfort
        low = np.floor((center - reach - self.origin) / self.cell).astype(int).clip(0)
        high = np.ceil((center + reach - self.origin) / self.cell).astype(int) + 1
        part = self.clearance[low[0] : high[0], low[1] : high[1]]
        x = self.origin[0] + (low[0] + np.arange(part.shape[0]) + 0.5) * self.cell
        y = self.origin[1] + (low[1] + np.arange(part.shape[1]) + 0.5) * self.cell
        np.minimum(part, self._to(index, x[:, None], y[None]), out=part)

    def _to(self, index: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distances m from points (x, y) m to one obstacle, broadcast."""
        count = len(self.boxes)
        if index < count:
            return _to_box(x, y, self.boxes[index])
        return _to_disc(x, y, self.discs[index - count])

    def index(self, points: np.ndarray) -> np.ndarray:
        """Return the cells ``[*B, 2]`` of points ``[*B, 2]``, clipped to the grid."""
        cells = np.floor((np.asarray(points) - self.origin) / self.cell).astype(int)
        return cells.clip(0, np.array(self.clearance.shape) - 1)

    def centers(self, mask: np.ndarray) -> np.ndarray:
        """Return the centers ``[C, 2]`` m of the cells where ``mask [X, Y]`` is true."""
        return self.origin + (np.argwhere(mask) + 0.5) * self.cell

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the exact distances ``[P]`` m from points ``[P, 2]`` to the obstacles."""
        found = np.full(len(points), np.inf)
        for index in range(len(self._centers)):
            np.minimum(found, self._to(index, *np.asarray(points).T), out=found)
        return found

    def _smallest_distance(self, points: np.ndarray) -> float:
        """Return the smallest exact distance of points ``[P, 2]``, at most ``comfort``, m.

        Most points and obstacles are ruled out by the cells.
        """
        cells = np.floor((points - self.origin) / self.cell).astype(int)
        inside = ((cells >= 0) & (cells < self.clearance.shape)).all(-1)
        rough = self.clearance[tuple(self.index(points).T)]
        slack = self.cell * math.sqrt(0.5) + 1e-9  # m from a point to the center of its cell
        near = points[~inside | (rough <= rough.min() + 2.0 * slack)]
        low = near.min(0) - self.comfort - self._extents
        high = near.max(0) + self.comfort + self._extents
        chosen = ((self._centers >= low) & (self._centers <= high)).all(-1)
        distances = [float(self._to(int(k), *near.T).min()) for k in np.flatnonzero(chosen)]
        return min([self.comfort, *distances])

    def connected(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Return whether there is a path between two points."""
        first, second = (self.regions[tuple(self.index(point))] for point in (a, b))
        return bool(first == second and first != 0)

    def path(self, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return a smooth path ``[P, 2]`` m, points at most about 0.1 m apart.

        Raises:
            NoPathError: If a point is too close to obstacles or they are not connected.
        """
        start, goal = np.asarray(start, float), np.asarray(goal, float)
        if not self.connected(start, goal):
            raise NoPathError(f"no path from {start.tolist()} to {goal.tolist()}")
        points = self._route(start, goal)
        points = self._smooth(np.concatenate([start[None], points[1:-1], goal[None]]))
        if len(points) > MAX_PATH_POINTS:
            length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
            points = resample(points, length / (MAX_PATH_POINTS - 1) * (1 + 1e-9))
        return points

    def _route(self, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return the centers of the cells of the cheapest route."""
        first, last = self.index(start), self.index(goal)
        low, search = self._search(int(self.regions[tuple(first)]))
        search.find_costs([tuple(first - low)], [tuple(last - low)])
        cells = np.array(search.traceback(tuple(last - low))) + low
        return self.origin + (cells + 0.5) * self.cell

    def _search(self, region: int) -> tuple[np.ndarray, MCP_Geometric]:
        """Return the search in the bounding rectangle of a region, and its first cell ``[2]``."""
        if region not in self._searches:
            rows, columns = np.nonzero(self.regions == region)
            low = np.array([rows.min(), columns.min()])
            part = self.clearance[low[0] : rows.max() + 1, low[1] : columns.max() + 1]
            span = self.comfort - self.min_clearance
            share = ((self.comfort - part) / span).clip(0.0, 1.0)
            costs = np.where(part >= self.min_clearance, 1.0 + self.weight * share**2, -1.0)
            self._searches[region] = low, MCP_Geometric(costs)
        return self._searches[region]

    def _smooth(self, points: np.ndarray) -> np.ndarray:
        """Return the moving average of a polyline, as far as it keeps the clearance."""
        dense = resample(points, self.cell)
        for window in _SMOOTHING_M:
            half = round(window / self.cell / 2)
            if len(dense) <= 2 * half:
                continue
            # Point reflection at the ends keeps the ends fixed.
            head, tail = 2 * dense[0] - dense[half:0:-1], 2 * dense[-1] - dense[-2 : -half - 2 : -1]
            padded = np.concatenate([head, dense, tail])
            kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
            rounded = np.stack([np.convolve(padded[:, k], kernel, "valid") for k in (0, 1)], axis=1)
            kept = self._smallest_distance(dense)
            if self._smallest_distance(rounded) >= min(kept, self.min_clearance):
                return resample(rounded)
        return resample(dense)


def _extents(boxes: np.ndarray, discs: np.ndarray) -> np.ndarray:
    """Return half the size ``[W + D, 2]`` m of obstacles along x and y."""
    cos, sin = np.abs(np.cos(boxes[:, 4])), np.abs(np.sin(boxes[:, 4]))
    x, y = cos * boxes[:, 2] + sin * boxes[:, 3], sin * boxes[:, 2] + cos * boxes[:, 3]
    return np.concatenate([np.stack([x, y], axis=-1), np.tile(discs[:, 2:], 2)])


def _to_box(x: np.ndarray, y: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return the distances m from points to an oriented box."""
    dx, dy = x - box[0], y - box[1]
    cos, sin = math.cos(box[4]), math.sin(box[4])
    along = np.maximum(np.abs(cos * dx + sin * dy) - box[2], 0.0)
    across = np.maximum(np.abs(cos * dy - sin * dx) - box[3], 0.0)
    return np.sqrt(along * along + across * across)


def _to_disc(x: np.ndarray, y: np.ndarray, disc: np.ndarray) -> np.ndarray:
    """Return the distances m from points to a disc."""
    dx, dy = x - disc[0], y - disc[1]
    return np.maximum(np.sqrt(dx * dx + dy * dy) - disc[2], 0.0)
