"""Occupancy maps: cells that are occupied, free or unknown, and paths among them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from skimage.measure import label

from navrl.checks import checked_numbers, checked_pose
from navrl.untrusted import is_number
from navrl.worlds.clearance_map import ClearanceMap
from navrl.worlds.places.cells import boxes_of_cells
from navrl.worlds.places.place import FreeRegion, turned
from navrl.worlds.places.reading import FARTHEST_M
from navrl.worlds.planner import NoPathError

Message: TypeAlias = Any
"""A message of ROS 1 or ROS 2, or a field of one; ROS is not imported."""

MAX_CELLS = 100_000_000  # of a map
START_TOLERANCE_M = 0.3  # m; a robot that is closer to obstacles than its path starts there
_EIGHT = np.ones((3, 3), dtype=bool)  # a cell and its eight neighbors


@dataclass(frozen=True, eq=False)
class OccupancyMap:
    """Map of cells that are occupied, free or unknown.

    Args:
        values: ``[X, Y]`` int8, probability of an obstacle in percent, -1 if unknown. The first
            axis is along x, the second along y of the frame ``origin``.
        cell: Size of a cell, m.
        origin: ``[3]`` pose (x, y, yaw) of the corner of the cell (0, 0) in the map frame, m and
            rad.
        occupied_percent: Smallest value of an occupied cell.
        free_percent: Largest value of a free cell; values in between are unknown.

    Raises:
        ValueError: If a value is out of range, or no cell is free.

    Example:
        >>> values = np.zeros((60, 40), dtype=np.int8)  # 3 m x 2 m
        >>> values[28:32, :25] = 100  # a wall with a passage above it
        >>> path = OccupancyMap(values, 0.05, np.zeros(3)).path([0.7, 0.5], [2.3, 0.5])
        >>> bool(path[:, 1].max() > 1.45)
        True

    Reference:
        nav_msgs/OccupancyGrid of ROS; thresholds of Nav2's map saver.
    """

    values: np.ndarray
    cell: float
    origin: np.ndarray
    occupied_percent: float = 65.0
    free_percent: float = 25.0
    _grids: dict[tuple[float, float], ClearanceMap] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        """Check the values."""
        x, y, yaw = checked_pose("origin", self.origin).tolist()
        if not is_number(self.cell, 0.001, 10.0):
            raise ValueError(f"resolution={self.cell}: must be in 0.001 to 10 m")
        if not all(is_number(value, -FARTHEST_M, FARTHEST_M) for value in (x, y, yaw)):
            raise ValueError(f"origin={[x, y, yaw]}: must be three numbers within {FARTHEST_M:g}")
        low, high = self.free_percent, self.occupied_percent
        if not 0 <= low < high <= 100:
            raise ValueError(
                f"free={low} %, occupied={high} %: must be 0 <= free < occupied <= 100"
            )
        invalid = self.values[(self.values < -1) | (self.values > 100)]
        if len(invalid):
            found = invalid[0]
            raise ValueError(f"data: has {found}, each must be -1 or in 0 to 100")
        if not self.free.any():
            raise ValueError(f"data: must have a free cell, a value of 0 to {low:g}")

    @classmethod
    def from_message(
        cls, message: Message, occupied_percent: float = 65.0, free_percent: float = 25.0
    ) -> OccupancyMap:
        """Read a nav_msgs/OccupancyGrid, or an object with its fields ``info`` and ``data``.

        Args:
            message: The message; its data are not kept.
            occupied_percent: As of the class.
            free_percent: As of the class.

        Raises:
            ValueError: If a field is out of range; the error names it.
        """
        info, data = message.info, np.asarray(message.data)
        width, height = info.width, info.height
        if not (0 < width * height <= MAX_CELLS and width > 0 and len(data) == width * height):
            raise ValueError(
                f"width={width}, height={height}: must be > 0, and data must have width * height = "
                f"{width * height} values, at most {MAX_CELLS}, got {len(data)}"
            )
        place, turn = info.origin.position, info.origin.orientation
        values = data.reshape(height, width).T
        origin = np.array([place.x, place.y, planar_yaw(turn)])
        return cls(values, float(info.resolution), origin, occupied_percent, free_percent)

    @cached_property
    def occupied(self) -> np.ndarray:
        """Occupied cells, ``[X, Y]`` bool."""
        return self.values >= self.occupied_percent

    @cached_property
    def free(self) -> np.ndarray:
        """Free cells, ``[X, Y]`` bool."""
        return (self.values >= 0) & (self.values <= self.free_percent)

    @cached_property
    def walls(self) -> np.ndarray:
        """Boxes ``[W, 5]`` that cover the occupied cells, m and rad in the map frame."""
        return self._boxes(self.occupied, np.zeros(2))

    @cached_property
    def limits(self) -> np.ndarray:
        """Boxes ``[U, 5]`` on the unknown cells around free ones and around the map."""
        free, occupied = np.pad(self.free, 1), np.pad(self.occupied, 1)
        edge = ndimage.binary_dilation(free, _EIGHT) & ~free & ~occupied
        return self._boxes(edge, np.full(2, -self.cell))

    def region(self, clearance: float = 0.25) -> FreeRegion:
        """Return the largest connected region of free cells inside the building.

        A region that covers more than half of the map's edge is taken as the outside and ignored,
        unless it is the only one.

        Args:
            clearance: Minimum distance of the region's cells to all cells that are not free, m.
                Narrower gaps do not connect two regions, e.g. the trace of a single lidar beam
                that passed through a window.
        """
        around = ~np.pad(self.free, 1, mode="edge")
        mask = np.ones_like(self.free)
        if around.any():
            gaps = np.asarray(ndimage.distance_transform_edt(~around))[1:-1, 1:-1]
            mask = (gaps - 0.5) * self.cell >= clearance
        labels = np.asarray(label(mask, connectivity=1))
        count = int(labels.max())
        sizes = np.bincount(labels.ravel(), minlength=count + 1)
        sizes[0] = 0
        edge = np.concatenate([labels[0], labels[-1], labels[1:-1, 0], labels[1:-1, -1]])
        inside = np.where(np.bincount(edge, minlength=count + 1) > 0.5 * len(edge), 0, sizes)
        largest = int((inside if inside.any() else sizes).argmax())
        mask = (labels == largest) & mask
        return FreeRegion(self.origin[:2], self.cell, mask, float(self.origin[2]))

    def clearance_map(self, clearance: float = 0.23, comfort: float = 0.6) -> ClearanceMap:
        """Return the map for paths, which also keep away from unknown cells.

        Args:
            clearance: Minimum distance of paths to obstacles, m.
            comfort: Distance from which on a path does not keep away from obstacles, m.
        """
        if (clearance, comfort) not in self._grids:
            boxes = np.concatenate([self.walls, self.limits])
            grid = ClearanceMap(boxes, np.zeros((0, 3)), clearance, comfort, is_tight=True)
            self._grids[clearance, comfort] = grid
        return self._grids[clearance, comfort]

    def path(
        self,
        start: ArrayLike,
        goal: ArrayLike,
        clearance: float = 0.23,
        comfort: float = 0.6,
    ) -> np.ndarray:
        """Return a smooth path ``[P, 2]`` m from ``start`` to ``goal``, both ``[2]`` m.

        If the start is too close to obstacles, the path begins at the nearest point within 0.3 m
        that is not.

        Raises:
            ValueError: If a point is not two numbers.
            NoPathError: If a point is outside the map, in or too close to an obstacle, or unknown,
                or if they are not connected.
        """
        grid = self.clearance_map(clearance, comfort)
        first, last = _checked_point("start", start), _checked_point("goal", goal)
        self._check(grid, "goal", last)
        try:
            self._check(grid, "start", first)
        except NoPathError:
            cells = grid.centers(grid.clearance >= clearance)
            cells = cells[self._is_free(cells)]
            gaps = np.hypot(*(cells - first).T)
            if not gaps.min(initial=math.inf) <= START_TOLERANCE_M:
                raise
            first = cells[int(gaps.argmin())]
        if not grid.connected(first, last):
            raise NoPathError(
                f"goal={_shown(last)}: must be reachable from {_shown(first)} with {clearance:g} m "
                "to obstacles and unknown cells"
            )
        return grid.path(first, last)

    def _check(self, grid: ClearanceMap, name: str, point: np.ndarray) -> None:
        """Raise ``NoPathError`` if a point cannot be on a path."""
        cells, inside = self._cells(point)
        if not inside:
            raise NoPathError(f"{name}={_shown(point)}: must be inside the map")
        here = tuple(cells)
        if self.occupied[here]:
            raise NoPathError(f"{name}={_shown(point)}: must not be in an obstacle")
        if not self.free[here]:
            raise NoPathError(f"{name}={_shown(point)}: must not be in an unknown part of the map")
        found = float(grid.clearance[tuple(grid.index(point))])
        if found < grid.min_clearance:
            raise NoPathError(
                f"{name}={_shown(point)}: must be at least {grid.min_clearance:g} m from obstacles "
                f"and unknown cells, is {found:.2f} m"
            )

    def _cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the cells ``[*B, 2]`` of points, clipped, and whether they are on the map."""
        cells = np.floor(turned(points - self.origin[:2], -self.origin[2]) / self.cell)
        inside = np.asarray((cells >= 0).all(-1) & (cells < self.values.shape).all(-1))
        return np.where(inside[..., None], cells, 0).astype(int), inside

    def _is_free(self, points: np.ndarray) -> np.ndarray:
        cells, inside = self._cells(points)
        return inside & self.free[cells[..., 0], cells[..., 1]]

    def _boxes(self, mask: np.ndarray, corner: np.ndarray) -> np.ndarray:
        """Return boxes ``[R, 5]`` in the map frame that cover cells, the first at ``corner``."""
        boxes = boxes_of_cells(mask, corner, self.cell)
        boxes[:, :2] = turned(boxes[:, :2], self.origin[2]) + self.origin[:2]
        boxes[:, 4] = self.origin[2]
        return boxes


def planar_yaw(q: Message) -> float:
    """Return the yaw of a quaternion, rad; NaN for one that is not of unit length."""
    length = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if not abs(length - 1.0) < 0.01:
        return math.nan
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def _checked_point(name: str, point: ArrayLike) -> np.ndarray:
    """Return a point ``[2]`` m; a pose ``[3]`` is one too."""
    allowed = "2 numbers (x, y) in m"
    found = checked_numbers(name, point, allowed)
    if found.shape not in ((2,), (3,)):
        raise ValueError(f"{name}={found.tolist()}: must be {allowed}")
    return found[:2]


def _shown(point: np.ndarray) -> str:
    return f"[{point[0]:.2f}, {point[1]:.2f}]"
