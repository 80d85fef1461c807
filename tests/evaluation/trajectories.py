"""Trajectories made by hand: one episode each, said in a line."""

import numpy as np

from navrl.envs import Outcome
from navrl.evaluation.metrics import Trajectory
from navrl.sim import Contact

DT, RADIUS = 0.2, 0.2


def trajectory(
    *positions,
    yaw=None,
    people=(),
    boxes=(),
    furniture=0,
    path=None,
    outcome=Outcome.SUCCESS,
    contact=Contact.NONE,
    padding=0,
):
    """Return one episode whose samples are ``positions``, ``people`` a series of boxes each."""
    count = len(positions)
    pose = np.full((1, count + padding, 3), np.nan)
    pose[0, :count, :2] = positions
    pose[0, :count, 2] = 0.0 if yaw is None else yaw
    pedestrians = np.full((1, count + padding, len(people), 5), np.nan)
    for k, series in enumerate(people):
        pedestrians[0, :count, k] = series
    path = np.array([positions[0], positions[-1]] if path is None else path, dtype=np.float32)
    boxes = np.array(boxes, dtype=float).reshape(1, -1, 5)
    return Trajectory(
        time_step_s=DT,
        robot_radius=RADIUS,
        max_speed=1.0,
        num_steps=np.array([count - 1]),
        outcome=np.array([outcome]),
        contact=np.array([contact]),
        pose=pose,
        pedestrians=pedestrians,
        boxes=boxes,
        is_furniture=(np.arange(boxes.shape[1]) >= boxes.shape[1] - furniture)[None],
        path=path[None],
        planned_length=np.linalg.norm(np.diff(path, axis=0), axis=1).sum()[None],
    )


def along(*xs):
    """Return positions on the x axis."""
    return [(x, 0.0) for x in xs]


def standing(x, y, half=0.1):
    """Return the box of somebody who stands there all the time."""
    return (x, y, half, half, 0.0)
