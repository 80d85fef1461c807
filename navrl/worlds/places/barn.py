"""Reader of the BARN worlds: cylinders on a grid, start and goal."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from navrl.untrusted import read_json
from navrl.worlds.places.place import Place
from navrl.worlds.places.reading import REMEDY, Reader

FORMAT = "barn-grid-1"


def load_barn(file: str | Path, indices: list[int] | None = None) -> list[Place]:
    """Read BARN worlds of format ``barn-grid-1``, one place each, named ``barn_INDEX``.

    Args:
        file: JSON with ``shape``, ``pitch``, ``radius``, ``height``, ``start``, ``goal`` and
            ``occ``, one string of hexadecimal digits per world. The cylinder of cell (i, j) is at
            x = -pitch (i + 1/2), y = pitch (j + 1/2).
        indices: Worlds to read; ``None`` for all.

    Raises:
        OSError: If the file does not exist or is not readable.
        DamagedFileError: If it has another format; the message has the file, key and value.
        ValueError: If an index is out of range.

    Reference:
        Perille et al., "Benchmarking Metric Ground Navigation", SSRR 2020.
    """
    reader = Reader(file, read_json(file, REMEDY))
    if reader.get("format") != FORMAT:
        raise reader.error("format", reader.values["format"], repr(FORMAT))
    worlds = reader.get("occ")
    if not isinstance(worlds, list) or not worlds:
        raise reader.error("occ", worlds, "a list of worlds")
    chosen = range(len(worlds)) if indices is None else indices
    for index in chosen:
        if not 0 <= index < len(worlds):
            raise ValueError(f"index={index}: must be in 0 to {len(worlds) - 1}, as in {file}")
    rows, columns = (int(size) for size in reader.row("shape", 2, low=1))
    pitch, radius = reader.number("pitch", 0.01, 10.0), reader.number("radius", 0.01, 10.0)
    height = reader.number("height", 0.01, 100.0)
    start, goal = reader.row("start", 3), reader.row("goal", 2)
    places = []
    for index in chosen:
        occupied = _occupied(reader, index, worlds[index], rows, columns)
        x, y = -pitch * (occupied[:, 0] + 0.5), pitch * (occupied[:, 1] + 0.5)
        discs = np.column_stack([x, y, np.full(len(x), radius)])
        heights = np.tile([0.0, height], (len(discs), 1))
        places.append(
            Place(f"barn_{index:03d}", discs=discs, disc_heights=heights, start=start, goal=goal)
        )
    return places


def _occupied(reader: Reader, index: int, text: object, rows: int, columns: int) -> np.ndarray:
    """Return the occupied cells ``[C, 2]`` of a world."""
    size = math.ceil(rows * columns / 8)
    try:
        data = bytes.fromhex(text) if isinstance(text, str) else b""
    except ValueError:
        data = b""
    if len(data) != size:
        allowed = f"{2 * size} hexadecimal digits, one bit for each of {rows} x {columns} cells"
        raise reader.error(f"occ[{index}]", text, allowed)
    bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8))[: rows * columns]
    cells = np.argwhere(bits.reshape(rows, columns))
    if not len(cells):
        raise reader.error(f"occ[{index}]", text, "a world with at least one cylinder")
    return cells
