"""Global path planning on an inflated occupancy grid."""

from __future__ import annotations

import math

import numpy as np
from skimage.graph import MCP_Geometric
from skimage.measure import label

from navrl.worlds.scenario import MAX_PATH_POINTS

_SPACING = 0.1  # m between points of a finished path
_INFLATIONS = (0.4, 0.3, 0.25)  # m, the largest that connects start and goal is used


class NoPathError(ValueError):
    """Error for two points that are not connected at the required clearance."""


class Grid:
    """Clearance map of a world with shortest routes.

    Args:
        boxes: ``[W, 5]`` walls, axis-aligned (yaw 0), m.
        extent: (x0, y0, x1, y1) m, region of planning.
        inside: ``[2]`` m, a point of the free space. Cells that are not reachable from it, such as
            those outside the outer walls, count as occupied.
        cell: Size of a grid cell, m.

    Reference:
        Paper Sec. III: A* on a map of the empty environment. A* and the Dijkstra field used here
        return the same lengths; one field gives all routes to the same goal.
    """

    def __init__(
        self,
        boxes: np.ndarray,
        extent: tuple[float, float, float, float],
        inside: np.ndarray,
        cell: float = 0.1,
    ) -> None:
        self.boxes, self.origin, self.cell = boxes, np.array(extent[:2]), cell
        x = np.arange(extent[0] + cell / 2, extent[2], cell)
        y = np.arange(extent[1] + cell / 2, extent[3], cell)
        # Axis-aligned boxes: each axis separately, then one outer sum per box.
        dx = (np.abs(x[None] - boxes[:, :1]) - boxes[:, 2:3]).clip(min=0.0)
        dy = (np.abs(y[None] - boxes[:, 1:2]) - boxes[:, 3:4]).clip(min=0.0)
        squared = np.full((len(x), len(y)), np.inf)
        for ax, ay in zip(dx**2, dy**2, strict=True):
            np.minimum(squared, ax[:, None] + ay[None], out=squared)
        self.clearance = np.sqrt(squared)
        regions = np.asarray(label(self.clearance >= cell, connectivity=1))
        self.clearance[regions != regions[tuple(self.index(inside))]] = 0.0

    def index(self, points: np.ndarray) -> np.ndarray:
        """Return the cells ``[*B, 2]`` of points ``[*B, 2]``, clipped to the grid."""
        cells = np.floor((points - self.origin) / self.cell).astype(int)
        return cells.clip(0, np.array(self.clearance.shape) - 1)

    def clearance_at(self, points: np.ndarray) -> np.ndarray:
        """Return the distance ``[*B]`` m from the points' cells to the nearest wall."""
        cells = self.index(np.asarray(points))
        return self.clearance[cells[..., 0], cells[..., 1]]

    def distance(self, points: np.ndarray, half_size: float = 0.0) -> np.ndarray:
        """Return the exact distance ``[P]`` m to the walls of squares around ``points [P, 2]``."""
        gap = np.abs(points[:, None] - self.boxes[:, :2]) - self.boxes[:, 2:4] - half_size
        return np.linalg.norm(gap.clip(min=0.0), axis=-1).min(axis=-1, initial=np.inf)

    def field(self, goal: np.ndarray, inflation: float) -> Field:
        """Return all shortest routes to ``goal`` with clearance ``inflation`` m."""
        return Field(self, goal, inflation)

    def sample_free(self, generator: np.random.Generator, inflation: float) -> np.ndarray:
        """Draw the center of a cell with a clearance of at least ``inflation`` m.

        Raises:
            NoPathError: If there is none.
        """
        free = np.argwhere(self.clearance >= inflation)
        if not len(free):
            raise NoPathError(f"inflation={inflation}: no cell has that clearance")
        return self.origin + (free[generator.integers(len(free))] + 0.5) * self.cell

    def is_visible(self, a: np.ndarray, b: np.ndarray, inflation: float) -> bool:
        """Return whether the line from a to b has a clearance of at least ``inflation`` m."""
        count = max(int(np.ceil(length(b - a) / (self.cell / 2))), 1)
        way = a + np.linspace(0.0, 1.0, count + 1)[:, None] * (b - a)
        return bool((self.clearance_at(way) >= inflation).all())


class Field:
    """Shortest routes from all cells to one goal."""

    def __init__(self, grid: Grid, goal: np.ndarray, inflation: float) -> None:
        self.grid, self.goal, self.inflation = grid, np.asarray(goal, dtype=float), inflation
        costs = np.where(grid.clearance >= inflation, 1.0, -1.0)
        cell = tuple(grid.index(self.goal))
        costs[cell] = 1.0
        self._search = MCP_Geometric(costs)
        self._distance, _ = self._search.find_costs([cell])

    def reaches(self, start: np.ndarray) -> bool:
        """Return whether a route from ``start`` exists."""
        return bool(np.isfinite(self._distance[tuple(self.grid.index(start))]))

    def route(self, start: np.ndarray) -> np.ndarray:
        """Return the shortcut route ``[R, 2]`` m from ``start`` to the goal (string pulling).

        Raises:
            NoPathError: If there is none.
        """
        start = np.asarray(start, dtype=float)
        if not self.reaches(start):
            raise NoPathError(f"no route from {start.tolist()} to {self.goal.tolist()}")
        cells = np.array(self._search.traceback(tuple(self.grid.index(start))))[::-1]
        points = self.grid.origin + (cells + 0.5) * self.grid.cell
        return self._pull(np.concatenate([start[None], points[1:-1], self.goal[None]]))

    def _pull(self, points: np.ndarray) -> np.ndarray:
        kept, anchor, last = [0], 0, len(points) - 1
        while anchor < last:
            # Bisect the longest visible stretch: a few visibility checks instead of one per point.
            low, high = anchor + 1, last + 1
            if self._is_visible(points, anchor, last):
                low = last
            while low < last and high - low > 1:
                middle = (low + high) // 2
                if self._is_visible(points, anchor, middle):
                    low = middle
                else:
                    high = middle
            anchor = low
            kept.append(anchor)
        return points[kept]

    def _is_visible(self, points: np.ndarray, a: int, b: int) -> bool:
        return self.grid.is_visible(points[a], points[b], self.inflation - 1e-9)


def length(vector: np.ndarray) -> float:
    """Return the length of ``vector`` [2], equal on all machines to the last bit.

    ``np.linalg.norm`` calls BLAS for a single vector, which fuses sum and product on some
    machines.
    """
    return math.sqrt(vector[0] * vector[0] + vector[1] * vector[1])


def resample(points: np.ndarray, spacing: float = _SPACING) -> np.ndarray:
    """Resample a polyline to points at most ``spacing`` m apart, including both ends."""
    arc = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    count = max(int(np.ceil(arc[-1] / spacing - 1e-9)), 1)
    at = np.linspace(0.0, arc[-1], count + 1)
    return np.stack([np.interp(at, arc, points[:, axis]) for axis in range(2)], axis=1)


def smooth(points: np.ndarray, grid: Grid, clearance: float, window: float = 0.8) -> np.ndarray:
    """Smooth a polyline by a moving average, as far as the clearance allows.

    Args:
        points: ``[R, 2]`` m.
        grid: Clearance map.
        clearance: Minimum distance of smoothed corners to the walls, m.
        window: Length of the average, m; halved until the clearance holds. If it holds for no
            window, the polyline is not changed.

    Returns:
        ``[P, 2]`` m, points about 0.1 m apart.
    """
    dense = resample(points)
    while window > 2 * _SPACING:
        half = int(window / _SPACING / 2)
        # Point reflection at the ends keeps the ends fixed.
        head = 2 * dense[0] - dense[half:0:-1]
        tail = 2 * dense[-1] - dense[-2 : -half - 2 : -1]
        padded = np.concatenate([head, dense, tail])
        if len(padded) == len(dense) + 2 * half:
            kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
            rounded = np.stack([np.convolve(padded[:, k], kernel, "valid") for k in (0, 1)], axis=1)
            if (grid.distance(rounded) >= clearance).all():
                return resample(rounded)
        window /= 2
    return dense


def plan(grid: Grid, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the smoothed path ``[P, 2]`` m and its inflation, m.

    Raises:
        NoPathError: If start and goal are not connected.
    """
    for inflation in _INFLATIONS:
        field = grid.field(goal, inflation)
        if field.reaches(start):
            path = smooth(field.route(start), grid, max(inflation - 0.1, 0.2))
            if len(path) > MAX_PATH_POINTS:
                path = resample(path, 0.1 * len(path) / MAX_PATH_POINTS)
            return path[:MAX_PATH_POINTS], inflation
    raise NoPathError("start and goal are not connected")


def start_pose(path: np.ndarray) -> np.ndarray:
    """Return the pose ``[3]`` at the beginning of ``path``, facing along it."""
    ahead = path[min(3, len(path) - 1)] - path[0]
    return np.array([*path[0], np.arctan2(ahead[1], ahead[0])])
