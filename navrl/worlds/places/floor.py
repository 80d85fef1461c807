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
        is_closed: Whether walls enclose those cells; ``None`` if the place says which are free.
    """

    place: Place
    grid: ClearanceMap
    cells: np.ndarray
    is_closed: bool | None


def make_floor(
    place: Place,
    *,
    height: float,
    clearance: float,
    comfort: float,
    cell_clearance: float,
    is_closed: bool | None = None,
) -> Floor:
    """Return a place with its map and free cells.

    Args:
        place: The place.
        height: Height of the body that moves there, m: what begins above is no obstacle.
        clearance: Smallest distance of paths to obstacles, m.
        comfort: Distance beyond which a path no longer keeps away from obstacles, m.
        cell_clearance: Smallest distance of free cells to obstacles, m.
        is_closed: Whether walls enclose the free cells; ``None`` to find out.
    """
    bottom, top = place.heights.T
    touched = (bottom < height) & (top > 0.0)
    count = len(place.boxes)
    boxes = np.concatenate([place.boxes[touched[:count]], place.limits])
    discs, is_tight = place.discs[touched[count:]], len(place.limits) > 0
    grid = ClearanceMap(boxes, discs, clearance, comfort, is_tight=is_tight)
    mask = grid.clearance >= cell_clearance
    if place.free is not None:
        cells = grid.centers(mask)
        return Floor(place, grid, cells[place.free.contains(cells)], None)
    mask, is_closed = _inside(mask, grid, is_closed)
    return Floor(place, grid, grid.centers(mask), is_closed)


def _inside(
    mask: np.ndarray, grid: ClearanceMap, is_closed: bool | None
) -> tuple[np.ndarray, bool]:
    """Return which cells are inside the place, and whether walls enclose them."""
    outside = grid.regions[0, 0]  # the open space around walls
    sizes = np.bincount(grid.regions[mask & (grid.regions != outside)], minlength=2)
    sizes[0] = 0
    if is_closed is None:
        is_closed = bool(sizes.max() > 0)
    region = int(sizes.argmax()) if sizes.max() > 0 else -1
    return mask & (grid.regions == (region if is_closed else outside)), is_closed
