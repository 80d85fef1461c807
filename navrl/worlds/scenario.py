"""Scenarios: plain data that determines an episode except the robot's commands."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from navrl.files import write_text
from navrl.untrusted import DamagedFileError, read_text
from navrl.worlds.pedestrian import MAX_ROUTE_POINTS, Pedestrian

__all__ = ["MAX_PATH_POINTS", "MAX_ROUTE_POINTS", "Pedestrian", "Scenario"]

MAX_PATH_POINTS = 200
"""Maximum number of points of a global path."""
_FORMATS = ("navrl-scenario-1", "navrl-scenario-2")
_ADDED = {"num_furniture": 0, "discs": (), "heights": ()}  # keys that older files lack
_MAX_NAME = 200  # characters of a suite or a kind of world
_KINDS = {"suite": str, "kind": str} | dict.fromkeys(
    ("seed", "index", "noise_seed", "num_furniture"), int
)
_DECIMALS = 6  # of meters and radians in a fingerprint


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
        num_furniture: Number of obstacles, the last ones of boxes and then discs, that are
            furniture instead of walls. It only classifies collisions; robot and lidar do not
            distinguish them.
        discs: ``[D, 3]`` round obstacles (cx, cy, radius), m, world.
        heights: ``[W + D, 2]`` m over the floor, bottom and top of each box and then each disc:
            a lidar at height h sees those with bottom <= h < top, a robot of height H touches those
            with bottom < H and top > 0. Empty if all of them reach from the floor to the ceiling.

    Raises:
        ValueError: If a shape or value is wrong, or there is more furniture than obstacles.
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
    discs: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    heights: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        expected = {"boxes": (None, 5), "start": (3,), "goal": (2,), "path": (None, 2)}
        expected |= {"discs": (None, 3), "heights": (None, 2)}
        for name, shape in expected.items():
            got = np.shape(getattr(self, name))
            fits = len(got) == len(shape) and all(
                want is None or want == have for want, have in zip(shape, got, strict=True)
            )
            if not fits:
                raise ValueError(f"{name}.shape={list(got)}: must be {list(shape)}")
        if not 2 <= len(self.path) <= MAX_PATH_POINTS:
            raise ValueError(f"path: must have 2 to {MAX_PATH_POINTS} points, got {len(self.path)}")
        count = len(self.boxes) + len(self.discs)
        if not 0 <= self.num_furniture <= count:
            raise ValueError(
                f"num_furniture={self.num_furniture}: must be in 0 to {count}, all boxes and discs"
            )
        if len(self.heights) not in (0, count):
            raise ValueError(f"heights: must have {count} rows, one per box and disc, or none")
        if not (np.isfinite(self.heights).all() and (np.diff(self.heights) > 0).all()):
            raise ValueError("heights: must be finite with bottom < top")
        if not (np.isfinite(self.discs).all() and (self.discs[:, 2] > 0).all()):
            raise ValueError("discs: must be finite with radius > 0")

    @property
    def obstacles(self) -> np.ndarray:
        """Boxes and bounding squares of discs, ``[W + D, 5]``, m and rad, world."""
        squares = np.zeros((len(self.discs), 5))
        squares[:, :3], squares[:, 3] = self.discs, self.discs[:, 2]
        return np.concatenate([self.boxes, squares])

    def to_dict(self) -> dict:
        """Return plain lists and numbers, from which floats are restored exactly.

        What a scenario does not use is omitted, so that older scenarios have the same text and
        hash: ``num_furniture`` if it is 0, and the properties of the second format.
        """
        plain = {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in vars(self).items()
        }
        plain["pedestrians"] = [person.to_dict() for person in self.pedestrians]
        for name in _ADDED:
            if not plain[name]:
                del plain[name]
        is_first = not (len(self.discs) or len(self.heights))
        is_first &= all(person.is_plain for person in self.pedestrians)
        return {"format": _FORMATS[0 if is_first else 1], **plain}

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
        plain = dict[str, Any]({**_ADDED, **plain})
        if plain.pop("format", None) not in _FORMATS:
            raise ValueError(f"scenario: format must be one of {', '.join(_FORMATS)}")
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
        people = tuple(Pedestrian.from_dict(person) for person in plain["pedestrians"])
        arrays = {
            name: np.asarray(plain[name], dtype=np.float64)
            for name in ("boxes", "start", "goal", "path", "discs", "heights")
        }
        for name, columns in (("boxes", 5), ("discs", 3), ("heights", 2)):
            arrays[name] = arrays[name].reshape(-1, columns)
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


def _canonical(plain: object) -> str:
    return json.dumps(plain, sort_keys=True, separators=(",", ":"))


def _rounded(value: object) -> object:
    """Round all floats of plain data and replace -0 by 0."""
    if isinstance(value, float):
        return round(value, _DECIMALS) + 0.0
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value
