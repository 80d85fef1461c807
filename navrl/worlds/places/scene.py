"""Reader of scenes: walls, furniture and free region as JSON, format navrl-scene-1."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
from skimage.draw import polygon2mask

from navrl.untrusted import read_json
from navrl.worlds.places.place import FreeRegion, Place
from navrl.worlds.places.reading import REMEDY, Reader, boxes_of_corners, boxes_of_segments

FORMAT = "navrl-scene-1"
SEGMENT_THICKNESS_M = 0.1  # m of a wall that is given as a segment
_CELL_M = 0.05  # m, of the region of a polygon
_MAX_CELLS = 10_000_000  # of a region


def load_scene(file: str | Path) -> Place:
    """Read a scene of format ``navrl-scene-1``.

    Walls are the boxes ``walls [x0, y0, x1, y1]`` and the segments ``wall_segments``;
    furniture has a class ``c``, an oriented ``box [cx, cy, hx, hy, yaw]`` and heights
    ``z [z0, z1]``. The free region is ``free``, polygons, or ``reachable_r025``, a bit grid.

    Raises:
        OSError: If the file does not exist or is not readable.
        DamagedFileError: If it is not a scene; the message has the file, key and value.

    Example:
        >>> import json, pathlib, tempfile
        >>> scene = {"format": "navrl-scene-1", "id": "hall", "wall_height": 2.5,
        ...          "walls": [[0.0, 0.0, 8.0, 0.1]]}
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "hall.json"
        >>> _ = file.write_text(json.dumps(scene))
        >>> load_scene(file).walls
        array([[4.  , 0.05, 4.  , 0.05, 0.  ]])
    """
    reader = Reader(file, read_json(file, REMEDY))
    if reader.get("format") != FORMAT:
        raise reader.error("format", reader.values["format"], repr(FORMAT))
    segments = boxes_of_segments(reader.rows("wall_segments", 4), SEGMENT_THICKNESS_M)
    furniture, heights, names = _furniture(reader)
    place = {
        "name": reader.text("id"),
        "walls": np.concatenate([boxes_of_corners(reader, "walls"), segments]),
        "wall_height": reader.number("wall_height", 0.1, 100.0),
        "furniture": furniture,
        "furniture_heights": heights,
        "furniture_names": names,
        "free": _free_region(reader),
    }
    if not len(place["walls"]) + len(furniture):
        raise reader.error("walls", [], "at least one wall or piece of furniture")
    return Place(**place)


def _furniture(reader: Reader) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    boxes, heights, names = [], [], []
    for item in reader.objects("furniture"):
        box, span = item.row("box", 5), item.row("z", 2)
        if not (box[2] > 0 and box[3] > 0):
            raise item.error("box", box.tolist(), "[cx, cy, hx, hy, yaw] with hx, hy > 0")
        if not span[0] < span[1]:
            raise item.error("z", span.tolist(), "[z0, z1] with z0 < z1")
        boxes.append(box)
        heights.append(span)
        names.append(item.text("c"))
    return np.array(boxes).reshape(-1, 5), np.array(heights).reshape(-1, 2), tuple(names)


def _free_region(reader: Reader) -> FreeRegion | None:
    if "free" in reader:
        free = reader.object("free")
        rings = [_ring(free, "outer")] if _is_ring(free, "outer") else _rings(free, "outer")
        return _rasterized(reader, rings, _rings(free, "holes"))
    if "reachable_r025" in reader:
        return _bit_grid(reader.object("reachable_r025"))
    return None


def _is_ring(reader: Reader, key: str) -> bool:
    """Return whether a value is one ring of points instead of a list of rings."""
    value: Any = reader.get(key)
    return bool(isinstance(value, list) and value and isinstance(value[0], list)) and not (
        value[0] and isinstance(value[0][0], list)
    )


def _ring(reader: Reader, key: str) -> np.ndarray:
    ring = reader.rows(key, 2)
    if len(ring) < 3:
        raise reader.error(key, ring.tolist(), "a polygon of at least 3 points")
    return ring


def _rings(reader: Reader, key: str) -> list[np.ndarray]:
    rings = reader.values.get(key) or []
    if not isinstance(rings, list):
        raise reader.error(key, rings, "a list of polygons")
    named = {f"{key}[{k}]": ring for k, ring in enumerate(rings)}
    inner = Reader(reader.file, named, reader.prefix)
    return [_ring(inner, name) for name in named]


def _rasterized(reader: Reader, outer: list[np.ndarray], holes: list[np.ndarray]) -> FreeRegion:
    corners = np.concatenate(outer)
    origin = corners.min(0)
    shape = tuple(np.ceil((corners.max(0) - origin) / _CELL_M).astype(int) + 1)
    if np.prod(shape) > _MAX_CELLS:
        raise reader.error("free", list(shape), f"a region of at most {_MAX_CELLS} cells of 5 cm")
    mask = np.zeros(shape, dtype=bool)
    for ring in outer:
        mask |= polygon2mask(shape, (ring - origin) / _CELL_M - 0.5)
    for ring in holes:
        mask &= ~polygon2mask(shape, (ring - origin) / _CELL_M - 0.5)
    return FreeRegion(origin, _CELL_M, mask)


def _bit_grid(reader: Reader) -> FreeRegion:
    shape = reader.row("shape", 2, low=1)
    rows, columns = (int(size) for size in shape)
    cell, text = reader.number("cell", 0.01, 10.0), cast(str, reader.get("bits"))
    size = -(-rows * columns // 8)
    try:
        data = bytes.fromhex(text)
    except (TypeError, ValueError):
        data = b""
    if len(data) != size:
        allowed = f"{2 * size} hexadecimal digits, one bit for each of {rows} x {columns} cells"
        raise reader.error("bits", text, allowed)
    bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8))[: rows * columns]
    return FreeRegion(reader.row("origin", 2), cell, bits.reshape(rows, columns).T.astype(bool))
