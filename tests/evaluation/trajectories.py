"""Trajectories made by hand: one episode each, said in a line."""

import dataclasses

import numpy as np

from navrl.envs import Outcome
from navrl.evaluation.metrics import Trajectory
from navrl.sim import Contact

DT, RADIUS = 0.2, 0.2


def trajectory(
    *positions,
    yaw=None,
    people=(),
    command=None,
    requested=None,
    boxes=(),
    furniture=0,
    path=None,
    outcome=Outcome.SUCCESS,
    contact=Contact.NONE,
    padding=0,
):
    """Return one episode whose samples are ``positions``, ``people`` a series of boxes each."""
    made = Trajectory.of_positions(
        positions,
        yaw=0.0 if yaw is None else yaw,
        people=people,
        command=command,
        requested=requested,
        boxes=boxes,
        num_furniture=furniture,
        path=path,
        outcome=outcome,
        contact=contact,
        time_step_s=DT,
        robot_radius=RADIUS,
    )
    series = ("pose", "pedestrians", "command", "requested")
    return dataclasses.replace(
        made, **{name: _padded(getattr(made, name), padding) for name in series}
    )


def _padded(samples, count):
    width = [(0, 0)] * samples.ndim
    width[1] = (0, count)
    return np.pad(samples, width, constant_values=np.nan)


def along(*xs):
    """Return positions on the x axis."""
    return [(x, 0.0) for x in xs]


def standing(x, y, half=0.1):
    """Return the box of somebody who stands there all the time."""
    return (x, y, half, half, 0.0)
