"""Place with the map and the free cells of a robot or a pedestrian."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navrl.worlds.clearance_map import ClearanceMap
from navrl.worlds.places.place import Place


class Floor(NamedTuple):
    """Place with its map and free cells.

    Args:
        place: The place.
        grid: Map for paths.
        cells: ``[C, 2]`` m, centers of the free cells inside the place.
    """

    place: Place
    grid: ClearanceMap
    cells: np.ndarray


def make_floor(
    place: Place, *, height: float, clearance: float, comfort: float, cell_clearance: float
) -> Floor:
    """Return a place with its map and free cells.

    Args:
        place: The place.
        height: Height of the body that moves there, m: what begins above is no obstacle.
        clearance: Smallest distance of paths to obstacles, m.
        comfort: Distance beyond which a path no longer keeps away from obstacles, m.
        cell_clearance: Smallest distance of free cells to obstacles, m.
    """
    bottom, top = place.heights.T
    touched = (bottom < height) & (top > 0.0)
    count = len(place.boxes)
    boxes = np.concatenate([place.boxes[touched[:count]], place.limits])
    discs, is_tight = place.discs[touched[count:]], len(place.limits) > 0
    grid = ClearanceMap(boxes, discs, clearance, comfort, is_tight=is_tight)
    return Floor(place, grid, _free_cells(place, grid, cell_clearance))


def _free_cells(place: Place, grid: ClearanceMap, clearance: float) -> np.ndarray:
    """Return the centers ``[C, 2]`` m of free cells inside the place."""
    mask = grid.clearance >= clearance
    if place.free is None:  # the largest region; the open space around walls counts as outside
        outside = grid.regions[0, 0]
        sizes = np.bincount(grid.regions[mask & (grid.regions != outside)], minlength=2)
        sizes[0] = 0
        is_closed = bool(sizes.max() > 0)
        mask &= grid.regions == (int(sizes.argmax()) if is_closed else outside)
        return grid.centers(mask)
    cells = grid.centers(mask)
    return cells[place.free.contains(cells)]
