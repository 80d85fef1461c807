"""Pedestrians of a scenario: a route walked back and forth, or a track with times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from navrl.ops.bodies import BODIES

MAX_ROUTE_POINTS = 32
"""Maximum number of points of a pedestrian's route; a track has any number."""
LEG_RADII_M = (0.03, 0.15)  # smallest and largest radius of a leg

_DEFAULT_BODY, _DEFAULT_LEG_RADIUS = "box", 0.07  # m, in the middle of 0.055 to 0.085 m


@dataclass(frozen=True)
class Pedestrian:
    """Scripted pedestrian, which walks its route back and forth or follows a track.

    Args:
        route: ``[R, 2]`` m, world; one point for a stationary pedestrian. The positions of a track.
        speed: Walking speed, m/s; 0 for a stationary pedestrian. Of a track its largest speed, see
            :meth:`tracked`.
        offset: Position at time zero in the back-and-forth coordinate, m: 0 to L is forth, L to 2 L
            is back. 0 for a track.
        half_size: Half depth (along the route) and half width, m. For ``disc`` and ``legs`` both
            are the radius of the body.
        times: ``[R]`` s since the start of the episode, increasing, of the positions of a track,
            linear in between. The pedestrian is absent before the first and after the last.
            ``None`` for a route.
        body: ``box``, ``disc``, or ``legs``: the lidar sees two discs that walk
            (:mod:`navrl.ops.gait`), the hull touches them and the disc of the body.
        leg_radius: Radius of a leg, m.

    Raises:
        ValueError: If a value is out of range.

    Reference:
        Paper Sec. IV-F1. The paper gives no size; 0.26 to 0.30 m is from the authors' precursor.
    """

    route: np.ndarray
    speed: float
    offset: float
    half_size: tuple[float, float] = (0.15, 0.15)
    times: np.ndarray | None = None
    body: str = _DEFAULT_BODY
    leg_radius: float = _DEFAULT_LEG_RADIUS

    def __post_init__(self) -> None:
        """Check the values."""
        shape, limit = np.shape(self.route), MAX_ROUTE_POINTS if self.times is None else np.inf
        if len(shape) != 2 or shape[1] != 2 or not 1 <= shape[0] <= limit:
            most = MAX_ROUTE_POINTS if self.times is None else ""
            raise ValueError(f"route.shape={list(shape)}: must be [1..{most}, 2]")
        if not (self.speed >= 0 and self.offset >= 0 and min(self.half_size) > 0):
            raise ValueError(
                f"speed={self.speed}, offset={self.offset}: must be >= 0; "
                f"half_size={self.half_size}: must be > 0"
            )
        if self.times is not None:
            _check_times(np.asarray(self.times), shape[0])
        if self.body not in BODIES:
            raise ValueError(f"body={self.body!r}: must be one of {', '.join(BODIES)}")
        if self.body != "box" and self.half_size[0] != self.half_size[1]:
            raise ValueError(
                f"half_size={list(self.half_size)}: must be two equal radii for body={self.body}"
            )
        low, high = LEG_RADII_M
        if not low <= self.leg_radius <= high:
            raise ValueError(f"leg_radius={self.leg_radius}: must be in {low} to {high} m")

    @classmethod
    def tracked(
        cls,
        times: np.ndarray,
        positions: np.ndarray,
        half_size: tuple[float, float] = (0.15, 0.15),
        body: str = _DEFAULT_BODY,
        leg_radius: float = _DEFAULT_LEG_RADIUS,
    ) -> Pedestrian:
        """Build a pedestrian that follows a track; it appears and leaves with it.

        Args:
            times: ``[T]`` s since the start of the episode, increasing.
            positions: ``[T, 2]`` m, world.
            half_size: See the class.
            body: See the class.
            leg_radius: See the class.

        Raises:
            ValueError: If a shape or value is out of range.

        Example:
            >>> positions = np.array([[0.0, 0.0], [3.0, 0.0]])
            >>> Pedestrian.tracked(np.array([0.0, 2.0]), positions).speed
            1.5
        """
        times, positions = np.asarray(times, float), np.asarray(positions, float)
        if positions.shape != (len(times), 2):
            raise ValueError(
                f"positions.shape={list(positions.shape)}: must be [{len(times)}, 2], as times"
            )
        _check_times(times, len(times))
        walked = np.linalg.norm(np.diff(positions, axis=0), axis=1)
        speed = float((walked / np.diff(times)).max(initial=0.0))
        return cls(positions, speed, 0.0, half_size, times, body, leg_radius)

    @property
    def is_static(self) -> bool:
        """Return whether the pedestrian is stationary."""
        return self.speed == 0.0

    @property
    def is_plain(self) -> bool:
        """Return whether the first format of scenarios has all of its properties."""
        return self.times is None and self.body == _DEFAULT_BODY

    def to_dict(self) -> dict:
        """Return plain lists and numbers; a plain pedestrian as in the first format."""
        half_size = list(self.half_size)
        if self.times is None:
            plain = {
                "route": self.route.tolist(),
                "speed": self.speed,
                "offset": self.offset,
                "half_size": half_size,
            }
        else:
            plain = {
                "times": np.asarray(self.times, float).tolist(),
                "positions": self.route.tolist(),
                "half_size": half_size,
            }
        if self.body != _DEFAULT_BODY:
            plain["body"] = self.body
        if self.body == "legs":
            plain["leg_radius"] = self.leg_radius
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping) -> Pedestrian:
        """Rebuild from :meth:`to_dict`.

        Raises:
            KeyError: If a key is missing.
            ValueError: If a value is out of range.
        """
        kind = {
            "half_size": tuple(plain["half_size"]),
            "body": plain.get("body", _DEFAULT_BODY),
            "leg_radius": float(plain.get("leg_radius", _DEFAULT_LEG_RADIUS)),
        }
        if "times" in plain:
            positions = np.asarray(plain["positions"], dtype=np.float64).reshape(-1, 2)
            return cls.tracked(np.asarray(plain["times"], dtype=np.float64), positions, **kind)
        route = np.asarray(plain["route"], dtype=np.float64).reshape(-1, 2)
        return cls(route, float(plain["speed"]), float(plain["offset"]), **kind)


def _check_times(times: np.ndarray, count: int) -> None:
    """Raise ``ValueError`` unless there are ``count`` increasing times."""
    if times.shape != (count,) or count == 0:
        raise ValueError(f"times.shape={list(times.shape)}: must be [{max(count, 1)}]")
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise ValueError("times: must be finite and increasing")
