"""Room between the robot and the pedestrians at the start of an episode."""

from __future__ import annotations

import numpy as np

from navrl.worlds.pedestrian import Pedestrian
from navrl.worlds.planner import NoPathError

_START_CLEARANCE_M = 1.0  # m from the robot to pedestrians at the start


def check_start(start: np.ndarray, people: tuple[Pedestrian, ...]) -> None:
    """Raise ``NoPathError`` if a pedestrian is near the robot at the start."""
    for person in people:
        if person.times is not None:
            soon = np.asarray(person.times)
            at = [np.interp(np.linspace(0, 1, 6), soon, person.route[:, k]) for k in (0, 1)]
            here = (soon[0] <= 1.0) & (soon[-1] >= 0.0)
            near = here and np.hypot(at[0] - start[0], at[1] - start[1]).min()
            is_near = here and near < _START_CLEARANCE_M
        else:
            is_near = _distance_at_start(person, start) < _START_CLEARANCE_M
        if is_near:
            raise NoPathError("a pedestrian is near the robot at the start")


def _distance_at_start(person: Pedestrian, start: np.ndarray) -> float:
    arc = np.concatenate([[0.0], np.linalg.norm(np.diff(person.route, axis=0), axis=1).cumsum()])
    along = person.offset % max(2 * arc[-1], 1e-9)
    along = min(along, 2 * arc[-1] - along)
    x, y = (np.interp(along, arc, person.route[:, k]) for k in (0, 1))
    return float(np.hypot(x - start[0], y - start[1]))
