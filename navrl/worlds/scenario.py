"""Scenarios: plain data that determines an episode except the robot's commands."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from navrl.files import write_text
from navrl.untrusted import DamagedFileError, read_text

MAX_ROUTE_POINTS = 32
"""Maximum number of points of a pedestrian's route."""
MAX_PATH_POINTS = 200
"""Maximum number of points of a global path."""
_FORMAT = "navrl-scenario-1"
_MAX_NAME = 200  # characters of a suite or a kind of world
_KINDS = {"suite": str, "kind": str} | dict.fromkeys(
    ("seed", "index", "noise_seed", "num_furniture"), int
)
_DECIMALS = 6  # of meters and radians in a fingerprint


@dataclass(frozen=True)
class Pedestrian:
    """Non-reactive pedestrian: a cuboid that walks its route back and forth.

    Args:
        route: ``[R, 2]`` m, world; one point for a stationary pedestrian.
        speed: Walking speed, m/s; 0 for a stationary pedestrian.
        offset: Position at time zero in the back-and-forth coordinate, m: 0 to L is forth, L to 2 L
            is back.
        half_size: Half depth (along the route) and half width, m.

    Raises:
        ValueError: If a value is out of range.

    Reference:
        Paper Sec. IV-F1. The paper gives no size; 0.26 to 0.30 m is from the authors' precursor.
    """

    route: np.ndarray
    speed: float
    offset: float
    half_size: tuple[float, float] = (0.15, 0.15)

    def __post_init__(self) -> None:
        shape = np.shape(self.route)
        if len(shape) != 2 or shape[1] != 2 or not 1 <= shape[0] <= MAX_ROUTE_POINTS:
            raise ValueError(f"route.shape={list(shape)}: must be [1..{MAX_ROUTE_POINTS}, 2]")
        if not (self.speed >= 0 and self.offset >= 0 and min(self.half_size) > 0):
            raise ValueError(
                f"speed={self.speed}, offset={self.offset}: must be >= 0; "
                f"half_size={self.half_size}: must be > 0"
            )

    @property
    def is_static(self) -> bool:
        """Return whether the pedestrian is stationary."""
        return self.speed == 0.0


@dataclass(frozen=True)
class Scenario:
    """Walls, path, pedestrians, start and goal of one episode.

    Fully determined by ``(suite, seed, index)``, and the same on every simulator.

    Args:
        suite: Name of its suite or distribution.
        seed: Seed of the suite.
        index: Index within the suite.
        kind: World type, e.g. ``corridor``.
        boxes: ``[W, 5]`` walls (cx, cy, hx, hy, yaw), m and rad, world.
        start: ``[3]`` robot pose (x, y, yaw).
        goal: ``[2]`` m.
        path: ``[P, 2]`` m, global path from start to goal, points about 0.1 m apart.
        pedestrians: Dynamic ones first, then static ones.
        noise_seed: Seed of the lidar's noise, in [0, 2**32).
        num_furniture: Number of ``boxes``, the last ones, that are furniture instead of walls. It
            only classifies collisions; robot and lidar do not distinguish them.

    Raises:
        ValueError: If a shape is wrong, or there is more furniture than boxes.
    """

    suite: str
    seed: int
    index: int
    kind: str
    boxes: np.ndarray
    start: np.ndarray
    goal: np.ndarray
    path: np.ndarray
    pedestrians: tuple[Pedestrian, ...]
    noise_seed: int
    num_furniture: int = 0

    def __post_init__(self) -> None:
        expected = {"boxes": (None, 5), "start": (3,), "goal": (2,), "path": (None, 2)}
        for name, shape in expected.items():
            got = np.shape(getattr(self, name))
            fits = len(got) == len(shape) and all(
                want is None or want == have for want, have in zip(shape, got, strict=True)
            )
            if not fits:
                raise ValueError(f"{name}.shape={list(got)}: must be {list(shape)}")
        if not 2 <= len(self.path) <= MAX_PATH_POINTS:
            raise ValueError(f"path: must have 2 to {MAX_PATH_POINTS} points, got {len(self.path)}")
        if not 0 <= self.num_furniture <= len(self.boxes):
            raise ValueError(
                f"num_furniture={self.num_furniture}: must be in 0 to {len(self.boxes)}, all boxes"
            )

    def to_dict(self) -> dict:
        """Return plain lists and numbers, from which floats are restored exactly.

        ``num_furniture`` is omitted if it is 0, so that older scenarios have the same hash.
        """
        plain = {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }
        plain["pedestrians"] = [
            {
                "route": person.route.tolist(),
                "speed": person.speed,
                "offset": person.offset,
                "half_size": list(person.half_size),
            }
            for person in self.pedestrians
        ]
        if not self.num_furniture:
            del plain["num_furniture"]
        return {"format": _FORMAT, **plain}

    @classmethod
    def from_dict(cls, plain: Mapping) -> Scenario:
        """Rebuild from :meth:`to_dict`.

        Raises:
            ValueError: If the format or a key is unknown, a key is missing, or a value has the
                wrong type.
        """
        try:
            return cls._from_dict(plain)
        except (AttributeError, KeyError, OverflowError, TypeError) as error:
            reason = f"{type(error).__name__}: {error}"
            raise ValueError(f"scenario: a value is of the wrong type ({reason})") from error

    @classmethod
    def _from_dict(cls, plain: Mapping[str, Any]) -> Scenario:
        plain = dict[str, Any]({"num_furniture": 0, **plain})
        if plain.pop("format", None) != _FORMAT:
            raise ValueError(f"scenario: format must be {_FORMAT!r}")
        missing = sorted(cls.__dataclass_fields__.keys() - plain.keys())
        unknown = sorted(plain.keys() - cls.__dataclass_fields__.keys())
        if missing or unknown:
            raise ValueError(f"scenario: missing {missing}, unknown {unknown}")
        for name, kind in _KINDS.items():
            if not isinstance(plain[name], kind) or isinstance(plain[name], bool):
                raise ValueError(f"scenario: {name}={plain[name]!r}: must be of {kind.__name__}")
        for name in ("suite", "kind"):
            if len(plain[name]) > _MAX_NAME:
                raise ValueError(f"scenario: {name}: must have at most {_MAX_NAME} characters")
        people = tuple(
            Pedestrian(
                np.asarray(person["route"], dtype=np.float64).reshape(-1, 2),
                float(person["speed"]),
                float(person["offset"]),
                tuple(person["half_size"]),
            )
            for person in plain["pedestrians"]
        )
        arrays = {
            name: np.asarray(plain[name], dtype=np.float64)
            for name in ("boxes", "start", "goal", "path")
        }
        arrays["boxes"] = arrays["boxes"].reshape(-1, 5)
        return cls(**{**plain, **arrays, "pedestrians": people})

    def to_json(self) -> str:
        """Return canonical JSON: sorted keys, no spaces."""
        return _canonical(self.to_dict())

    def fingerprint(self) -> str:
        """Return :meth:`to_json` with lengths and angles rounded to 1e-6, for hashes.

        The last bit of an arctangent depends on the processor; values rounded to 1e-6 do not.
        """
        return _canonical(_rounded(self.to_dict()))

    @classmethod
    def from_json(cls, text: str) -> Scenario:
        """Rebuild from :meth:`to_json`.

        Raises:
            ValueError: If it is not JSON, or as in :meth:`from_dict`.
        """
        try:
            plain = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ValueError(f"scenario: not JSON ({error})") from error
        return cls.from_dict(plain)

    def save(self, file: str | Path) -> None:
        """Write the scenario as JSON."""
        write_text(file, self.to_json() + "\n")

    @classmethod
    def load(cls, file: str | Path) -> Scenario:
        """Read a file written by :meth:`save`.

        Raises:
            OSError: If the file does not exist or is not readable.
            DamagedFileError: If it is not a scenario; the message names the file.
        """
        remedy = "save the scenario again"
        try:
            return cls.from_json(read_text(file, remedy))
        except DamagedFileError:
            raise
        except ValueError as error:
            raise DamagedFileError(file, error, remedy) from error


def _canonical(plain: dict) -> str:
    return json.dumps(plain, sort_keys=True, separators=(",", ":"))


def _rounded(value: object) -> object:
    """Round all floats of plain data and replace -0 by 0."""
    if isinstance(value, float):
        return round(value, _DECIMALS) + 0.0
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value
