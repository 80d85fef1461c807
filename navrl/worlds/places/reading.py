"""Checked values of untrusted files; errors have the file, key, value and what is allowed."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from navrl.untrusted import DamagedFileError, is_number, read_bytes

FARTHEST_M = 10_000.0  # m from the origin
REMEDY = "docs/places.md and docs/maps.md have the formats"
_SHOWN = 60  # characters of a value in an error
_MAX_PIXELS = 10_000  # along each side of a picture
_PICTURES = {"PPM": "PGM", "PNG": "PNG", "BMP": "BMP"}  # formats of Pillow and their names


class Reader:
    """Look up values of one file by key.

    Args:
        file: Path, named in errors.
        values: Outermost object of the file.
        prefix: Key of ``values`` in the file, with a trailing dot.
    """

    def __init__(self, file: str | Path, values: Mapping[str, Any], prefix: str = "") -> None:
        """Store the arguments."""
        self.file, self.values, self.prefix = file, values, prefix

    def __contains__(self, key: str) -> bool:
        return self.values.get(key) is not None

    def error(self, key: str, value: object, allowed: str) -> DamagedFileError:
        """Return the error for a value."""
        shown = repr(value)
        shown = shown if len(shown) <= _SHOWN else f"{shown[: _SHOWN - 3]}..."
        return DamagedFileError(self.file, f"{self.prefix}{key}={shown}: must be {allowed}", REMEDY)

    def get(self, key: str) -> object:
        """Return a value that must exist."""
        if key not in self.values:
            reason = f"{self.prefix}{key}: is missing, there are {', '.join(sorted(self.values))}"
            raise DamagedFileError(self.file, reason, REMEDY)
        return self.values[key]

    def text(self, key: str) -> str:
        """Return a string of 1 to 200 characters."""
        value = self.get(key)
        if not isinstance(value, str) or not 0 < len(value) <= 200:
            raise self.error(key, value, "text of 1 to 200 characters")
        return value

    def number(self, key: str, low: float = -FARTHEST_M, high: float = FARTHEST_M) -> float:
        """Return a finite number in [low, high]."""
        value = self.get(key)
        if not is_number(value, low, high):
            raise self.error(key, value, f"a number in {low:g} to {high:g}")
        return float(value)

    def row(self, key: str, size: int, low: float = -FARTHEST_M) -> np.ndarray:
        """Return ``size`` finite numbers."""
        return self._row(key, self.get(key), size, low)

    def rows(self, key: str, size: int) -> np.ndarray:
        """Return a list of rows of ``size`` numbers, ``[R, size]``; empty if the key is missing."""
        values = self.values.get(key) or []
        if not isinstance(values, list):
            raise self.error(key, values, "a list")
        found = [self._row(f"{key}[{k}]", value, size) for k, value in enumerate(values)]
        return np.array(found, dtype=float).reshape(-1, size)

    def objects(self, key: str) -> Iterator[Reader]:
        """Yield the objects of a list; none if the key is missing."""
        values = self.values.get(key) or []
        if not isinstance(values, list):
            raise self.error(key, values, "a list")
        for index, value in enumerate(values):
            if not isinstance(value, dict):
                raise self.error(f"{key}[{index}]", value, "an object")
            yield Reader(self.file, value, f"{self.prefix}{key}[{index}].")

    def object(self, key: str) -> Reader:
        """Return an object that must exist."""
        value = self.get(key)
        if not isinstance(value, dict):
            raise self.error(key, value, "an object")
        return Reader(self.file, value, f"{self.prefix}{key}.")

    def _row(self, key: str, value: object, size: int, low: float = -FARTHEST_M) -> np.ndarray:
        if (
            not isinstance(value, list)
            or len(value) != size
            or not all(is_number(item, low, FARTHEST_M) for item in value)
        ):
            raise self.error(key, value, f"{size} numbers in {low:g} to {FARTHEST_M:g}")
        return np.array(value, dtype=float)


def read_image(file: str | Path) -> Image.Image:
    """Read a PGM, PNG or BMP picture.

    Raises:
        OSError: If the file does not exist or is not readable.
        DamagedFileError: If it is no such picture, or too large.
    """
    content = io.BytesIO(read_bytes(file, REMEDY))
    try:
        with Image.open(content, formats=list(_PICTURES)) as image:
            if max(image.size) > _MAX_PIXELS:
                reason = f"size={list(image.size)}: must be at most {_MAX_PIXELS} pixels each"
                raise DamagedFileError(file, reason, REMEDY)
            image.load()
            return image
    except UnidentifiedImageError as error:
        names = ", ".join(_PICTURES.values())
        raise DamagedFileError(file, f"must be a picture, one of {names}", REMEDY) from error
    except DamagedFileError:
        raise
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise DamagedFileError(file, f"damaged picture ({error})", REMEDY) from error


def boxes_of_corners(reader: Reader, key: str) -> np.ndarray:
    """Return boxes ``[R, 5]`` of rows (x0, y0, x1, y1) with x0 < x1 and y0 < y1."""
    corners = reader.rows(key, 4)
    for index, (x0, y0, x1, y1) in enumerate(corners.tolist()):
        if not (x0 < x1 and y0 < y1):
            value = [x0, y0, x1, y1]
            raise reader.error(f"{key}[{index}]", value, "[x0, y0, x1, y1] with x0 < x1, y0 < y1")
    low, high = corners[:, :2], corners[:, 2:]
    return np.column_stack([(low + high) / 2, (high - low) / 2, np.zeros(len(corners))])


def boxes_of_segments(segments: np.ndarray, thickness: float) -> np.ndarray:
    """Return boxes ``[R, 5]`` around segments ``[R, 4]`` (x1, y1, x2, y2), with square ends."""
    step = segments[:, 2:] - segments[:, :2]
    half = thickness / 2
    along = np.hypot(step[:, 0], step[:, 1]) / 2 + half
    yaw = np.array([math.atan2(y, x) for x, y in step.tolist()])
    center = (segments[:, :2] + segments[:, 2:]) / 2
    return np.column_stack([center, along, np.full(len(step), half), yaw.reshape(-1)])
