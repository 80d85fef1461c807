"""Observations of the navigation environment: their spec and the privileged ones."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded

from navrl import keys
from navrl.envs.outcome import Outcome
from navrl.ops.distance import point_box_distance
from navrl.sim import Contact, Localization, SimState, Simulator
from navrl.worlds import MAX_PATH_POINTS


def observation_spec(
    simulator: Simulator, localization: Localization, terms: Sequence[str], privileged: bool
) -> Composite:
    """Return the spec of the observations, documented in :class:`navrl.envs.NavigationEnv`.

    Args:
        simulator: Simulator of N worlds.
        localization: Errors of the observed pose.
        terms: Names of the reward terms.
        privileged: Whether the observation includes the true state.
    """
    n, device = simulator.num_worlds, simulator.device
    lidar, robot = simulator.lidar, simulator.robot
    shapes = {
        keys.POSE: (n, 3),
        keys.VELOCITY: (n, robot.command_size),
        keys.SCAN_MOTION: (n, 2, 3),
        keys.COMMAND: (n, robot.command_size),
        keys.MOTION_AHEAD: (n, 3),
        keys.VELOCITY_AHEAD: (n, robot.command_size),
        keys.PATH: (n, MAX_PATH_POINTS, 2),
    }
    if privileged:
        shapes[keys.PEDESTRIAN_BOXES] = (n, simulator.max_pedestrians, 5)
        shapes[keys.PEDESTRIAN_CLEARANCE] = (n, 1)
        if not localization.is_exact:
            shapes[keys.TRUE_POSE] = (n, 3)
    spec: dict[str, TensorSpec] = {
        key: Unbounded(torch.Size(shape), device=device) for key, shape in shapes.items()
    }
    scan, single = torch.Size((n, lidar.num_beams)), torch.Size((n, 1))
    spec[keys.RANGES] = Bounded(0.0, lidar.max_range, shape=scan, device=device)
    if not lidar.coverage.is_full:
        spec[keys.MEASURED] = Binary(lidar.num_beams, scan, dtype=torch.bool, device=device)
    for key, codes in ((keys.OUTCOME, Outcome), (keys.CONTACT, Contact)):
        spec[key] = Categorical(len(codes), shape=single, dtype=torch.int64, device=device)
    rewards = {name: Unbounded(single, device=device) for name in terms}
    spec[keys.REWARD_TERMS] = Composite(rewards, shape=torch.Size((n,)))
    return Composite(spec, shape=torch.Size((n,)), device=device)


def privileged_observation(
    state: SimState, radius: float, localization: Localization
) -> dict[str, Tensor]:
    """Return the observations of the true state, for metrics and privileged controllers.

    Args:
        state: True state of N worlds.
        radius: Radius of the robot, m.
        localization: Errors of the observed pose; if it has any, the true pose is included.
    """
    distance = point_box_distance(state.pose[:, :2], state.pedestrians)
    clearance = distance.amin(dim=-1, keepdim=True) - radius
    values = {
        keys.PEDESTRIAN_BOXES: state.pedestrians,
        keys.PEDESTRIAN_CLEARANCE: clearance.clamp_min(0.0),
    }
    return values if localization.is_exact else {**values, keys.TRUE_POSE: state.pose}
