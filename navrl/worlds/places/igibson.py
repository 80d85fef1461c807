"""Reader of iGibson scenes: furniture of an iGSDF URDF, walls of a traversability map."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from scipy import ndimage

from navrl.untrusted import DamagedFileError, read_text
from navrl.worlds.places.cells import boxes_of_cells
from navrl.worlds.places.place import FreeRegion, Place
from navrl.worlds.places.reading import FARTHEST_M, REMEDY, read_image

RESOLUTION_M = 0.01  # m per pixel of a traversability map, iGibson's default
CELL_M = 0.05  # m, to which the map is reduced
WALL_THICKNESS_M = 0.15  # m of the blocked cells beside free ones that become walls
WALL_HEIGHT_M = 2.5
NO_FURNITURE = ("walls", "floors", "ceilings", "door", "window", "carpet")


def load_igibson(folder: str | Path) -> Place:
    """Read an iGibson scene: ``urdf/NAME_best.urdf`` and ``layout/floor_trav_no_obj_0.png``.

    Furniture is the bounding box of each link, turned by its yaw; doors are open. Walls are the
    blocked cells of the map without objects, and its traversable cells are the free region. The
    file of an iGSDF scene is named after the folder.

    Args:
        folder: Folder of the scene. The scenes need a license of their authors.

    Raises:
        OSError: If a file does not exist or is not readable.
        DamagedFileError: If a file has another content; the message has the file, key and value.

    Reference:
        Shen et al., "iGibson 1.0: a simulation environment for interactive tasks", 2021 (iGSDF).
    """
    folder = Path(folder)
    urdf = folder / "urdf" / f"{folder.name}_best.urdf"
    boxes, heights, names = _furniture(urdf)
    free = _traversable(folder / "layout" / "floor_trav_no_obj_0.png")
    near = ndimage.binary_dilation(free.mask, iterations=round(WALL_THICKNESS_M / CELL_M))
    return Place(
        name=folder.name,
        walls=boxes_of_cells(near & ~free.mask, free.origin, free.cell),
        wall_height=WALL_HEIGHT_M,
        furniture=boxes,
        furniture_heights=heights,
        furniture_names=names,
        free=free,
    )


def _furniture(file: Path) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    root = _parse(file)
    poses = {}
    for joint in root.iter("joint"):
        child, origin = joint.find("child"), joint.find("origin")
        if child is not None and origin is not None:
            name = child.get("link", "")
            rpy = _numbers(file, f"joint {name} rpy", origin.get("rpy", "0 0 0"))
            poses[name] = (_numbers(file, f"joint {name} xyz", origin.get("xyz", "0 0 0")), rpy[2])
    boxes, heights, names = [], [], []
    for link in root.iter("link"):
        name, size = link.get("name", ""), link.get("bounding_box")
        category = link.get("category", "")
        if size is None or category in NO_FURNITURE:
            continue
        half = _numbers(file, f"link {name} bounding_box", size) / 2
        if not (half > 0).all():
            raise _error(file, f"link {name} bounding_box", size, "three numbers > 0")
        if name not in poses:
            raise _error(file, f"link {name}", category, "the child of a joint with an origin")
        (x, y, z), yaw = poses[name]
        boxes.append([x, y, half[0], half[1], yaw])
        heights.append([z - half[2], z + half[2]])
        names.append(category)
    return np.array(boxes).reshape(-1, 5), np.array(heights).reshape(-1, 2), tuple(names)


def _parse(file: Path) -> ElementTree.Element:
    text = read_text(file, REMEDY)
    if "<!" in text.replace("<!--", ""):  # entities can expand to gigabytes
        raise DamagedFileError(file, "must have no document type and no entities", REMEDY)
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise DamagedFileError(file, f"not XML ({error})", REMEDY) from error


def _numbers(file: Path, key: str, text: str) -> np.ndarray:
    """Return three finite numbers."""
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not (np.abs(values) <= FARTHEST_M).all():
        raise _error(file, key, text, "three finite numbers")
    return values


def _traversable(file: Path) -> FreeRegion:
    """Return the cells whose pixels are all traversable (255); the map's center is the origin."""
    pixels = np.asarray(read_image(file).convert("L"))
    step = round(CELL_M / RESOLUTION_M)
    rows, columns = (size // step for size in pixels.shape)
    if not rows or not columns:
        raise _error(file, "size", pixels.shape, f"at least {step} pixels along each side")
    blocks = pixels[: rows * step, : columns * step].reshape(rows, step, columns, step)
    mask = (blocks == 255).all(axis=(1, 3)).T
    if not mask.any():
        raise DamagedFileError(file, "must have traversable cells, pixels of value 255", REMEDY)
    origin = -0.5 * RESOLUTION_M * np.array(pixels.shape[::-1], dtype=float)
    return FreeRegion(origin, CELL_M, mask)


def _error(file: Path, key: str, value: object, allowed: str) -> DamagedFileError:
    return DamagedFileError(file, f"{key}={value!r}: must be {allowed}", REMEDY)
