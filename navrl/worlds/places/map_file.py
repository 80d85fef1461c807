"""Reader of maps of ROS: a YAML file of map_server or Nav2 and its picture."""

from __future__ import annotations

import logging
from pathlib import Path, PurePosixPath

import numpy as np
from PIL import Image

from navrl.checks import checked_pose
from navrl.untrusted import DamagedFileError, read_yaml
from navrl.worlds.places.occupancy_map import OccupancyMap
from navrl.worlds.places.place import Place
from navrl.worlds.places.reading import REMEDY, Reader, read_image

MODES = ("trinary", "scale", "raw")
WALL_HEIGHT_M = 2.5
SUFFIXES = (".yaml", ".yml")
_LOG = logging.getLogger(__name__)
_NUMBERS = ("resolution", "origin", "occupied_thresh", "free_thresh", "negate")
_SAVED_UNKNOWN = (204, 205, 206)  # shades of 255 that map savers write for unknown cells


def load_map(file: str | Path, wall_height: float = WALL_HEIGHT_M) -> Place:
    """Read a map of map_server or Nav2 as a place that is named after the file.

    Walls are the occupied cells; the free region is the largest set of free cells that does not
    touch the edge of the map. Paths keep away from unknown cells, where nothing is to be seen.

    Args:
        file: YAML file, see :func:`load_occupancy_map`.
        wall_height: m.

    Raises:
        OSError: If the file does not exist or is not readable.
        DamagedFileError: If it is not such a map; the message has the file, key and value.
    """
    found = load_occupancy_map(file)
    if not len(found.walls):
        raise DamagedFileError(file, "image: must have an occupied cell", REMEDY)
    return Place(
        name=Path(file).stem,
        walls=found.walls,
        wall_height=wall_height,
        free=found.region(),
        limits=found.limits,
    )


def load_occupancy_map(file: str | Path) -> OccupancyMap:
    """Read a map of map_server or Nav2.

    Args:
        file: YAML with ``image`` (PGM, PNG or BMP in the folder of the file or below it),
            ``resolution`` m, ``origin [x, y, yaw]``, ``negate``, ``occupied_thresh``,
            ``free_thresh`` and ``mode``: ``trinary`` (default), ``scale`` or ``raw``.

    Raises:
        OSError: If the file does not exist or is not readable.
        DamagedFileError: If it is not such a map; the message has the file, key and value.

    Example:
        >>> import pathlib, tempfile
        >>> folder = pathlib.Path(tempfile.mkdtemp())
        >>> _ = (folder / "hall.pgm").write_text("P2 3 2 255  0 254 205  0 254 254")
        >>> text = "{image: hall.pgm, resolution: 0.5, origin: [0, 0, 0], negate: 0, "
        >>> text += "occupied_thresh: 0.65, free_thresh: 0.196}"
        >>> _ = (folder / "hall.yaml").write_text(text)
        >>> load_occupancy_map(folder / "hall.yaml").values.tolist()  # the last row is y = 0
        [[100, 100], [0, 0], [0, -1]]

    Reference:
        map_server of ROS 1 and nav2_map_server. In the mode ``raw``, negate is ignored as in Nav2.
    """
    reader = _reader(file)
    picture = _image_file(reader)
    mode = str(reader.values.get("mode", MODES[0])).lower()
    if mode not in MODES:
        raise reader.error("mode", reader.values["mode"], f"one of {', '.join(MODES)}")
    negate = reader.get("negate")
    if negate not in (0, 1):
        raise reader.error("negate", negate, "0 or 1")
    low, high = (reader.number(key, 0.0, 1.0) for key in ("free_thresh", "occupied_thresh"))
    if not low < high:
        raise reader.error("free_thresh", low, f"< occupied_thresh={high:g}")
    resolution, origin = reader.number("resolution", 0.001, 10.0), reader.row("origin", 3)
    try:
        checked_pose("origin", origin)
    except ValueError as error:
        raise DamagedFileError(file, str(error), REMEDY) from error
    try:
        shade, alpha = _shades(read_image(picture))
    except FileNotFoundError as error:
        raise reader.error("image", reader.values["image"], "a file that exists") from error
    if mode == "raw":
        values = np.rint(255.0 * shade)
        values[values > 100] = -1
    else:
        if mode == "trinary" and alpha is not None:
            shade = (3.0 * shade + alpha) / 4.0  # as both map servers do
        _warn_of_unknown(file, shade, low, bool(negate))
        values = _occupancy(shade if negate else 1.0 - shade, low, high, mode == "scale")
        if mode == "scale" and alpha is not None:
            values[alpha < 1.0] = -1
    try:
        return OccupancyMap(values[::-1].T.astype(np.int8), resolution, origin)
    except ValueError as error:
        raise DamagedFileError(file, f"image={picture.name!r}: {error}", REMEDY) from error


def map_image(file: str | Path) -> Path:
    """Return the picture of a map.

    Raises:
        OSError: If the file does not exist or is not readable.
        DamagedFileError: If the file is not YAML or names no picture that exists.
    """
    reader = _reader(file)
    picture = _image_file(reader)
    if not picture.is_file():
        raise reader.error("image", reader.values["image"], "a file that exists")
    return picture


def _reader(file: str | Path) -> Reader:
    values = read_yaml(file, REMEDY)
    # YAML 1.1 reads 5e-2 as text, the map servers as a number.
    return Reader(file, {k: _number(v) if k in _NUMBERS else v for k, v in values.items()})


def _number(value: object) -> object:
    if isinstance(value, list):
        return [_number(item) for item in value]
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _image_file(reader: Reader) -> Path:
    name = reader.text("image")
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts:
        allowed = f"in the folder of {Path(reader.file).name}, e.g. {path.name!r}"
        raise reader.error("image", name, allowed)
    return Path(reader.file).parent / path


def _shades(image: Image.Image) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the brightness ``[rows, columns]`` in 0 to 1, and the opacity if there is one."""
    if image.mode.startswith("I"):  # 16 bits
        return np.asarray(image, dtype=float) / 65535.0, None
    has_alpha = image.mode in ("LA", "PA", "RGBA") or "transparency" in image.info
    pixels = np.asarray(image.convert("RGBA" if has_alpha else "RGB"), dtype=float) / 255.0
    return pixels[..., :3].mean(-1), pixels[..., 3] if has_alpha else None


def _occupancy(occupied: np.ndarray, low: float, high: float, scales: bool) -> np.ndarray:
    """Return percent by the thresholds; what is in between is scaled, or unknown."""
    between = np.rint((occupied - low) / (high - low) * 100.0) if scales else -1.0
    return np.where(occupied > high, 100.0, np.where(occupied < low, 0.0, between))


def _warn_of_unknown(file: str | Path, shade: np.ndarray, low: float, negate: bool) -> None:
    """Warn if the shade of unknown cells counts as free, as with Nav2's default thresholds."""
    is_saved = np.isin(np.rint(255.0 * shade), _SAVED_UNKNOWN) & (1.0 - shade < low)
    if not negate and is_saved.mean() > 0.01:
        _LOG.warning(
            "%s: free_thresh=%g: %.0f %% of the cells count as free, but have the shade that map "
            "savers give to unknown cells, 205 of 255; with free_thresh: 0.19 they are unknown",
            file,
            low,
            100.0 * is_saved.mean(),
        )
