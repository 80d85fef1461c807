"""Episodes of table1 with the scan of an RPLidar A1, and a robot that is driven from outside."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import torch

from navrl.config import compose, instantiate
from navrl.envs.navigation import NavigationEnv
from navrl.evaluation.recorder import record_episode
from navrl.factory import make_env
from navrl.policies.classical.commands import normalized_action
from navrl.sim import BatchedSimulator, DifferentialDrive, Lidar
from navrl.transforms import compose as compose_steps

STEP_S = 0.2
BACKWARDS = (0.0, 0.0, math.pi)
RANGE_MAX = 12.0  # m


class SimulatedA1:
    """A robot with an A1 in episodes of table1, one command per step.

    Args:
        mount: (x, y, yaw) of the lidar in the robot frame, m and rad.
    """

    def __init__(self, mount: Sequence[float] = BACKWARDS) -> None:
        lidar = Lidar(
            360, RANGE_MAX, noise_amplitude=0.015, mount=mount, angle_min=-math.pi,
            angle_increment=2 * math.pi / 360,
        )  # fmt: skip
        self.mount, self.robot = tuple(mount), DifferentialDrive()
        simulator = BatchedSimulator(1, self.robot, lidar)
        env = NavigationEnv(simulator, None, rewards={}, privileged=True)
        self.env = make_env(env, compose_steps())
        self.suite = instantiate(compose("evaluate", ["suite=table1"]).suite)

    def outcomes(
        self,
        indices: Sequence[int],
        start: Callable[[np.ndarray], None],
        decide: Callable[[np.ndarray, np.ndarray], Sequence[float]],
    ) -> list[str]:
        """Play episodes and return their outcomes.

        Args:
            indices: Episodes of table1.
            start: Called at the start of an episode with its path ``[P, 2]`` m.
            decide: Maps pose ``[3]`` and ranges ``[360]`` m, inf for no return, to (v, w).
        """

        def policy(observed):
            pose, ranges = (observed[key][0].numpy().astype(float) for key in ("pose", "ranges"))
            if policy.is_new:
                start(observed["path"][0].numpy())
                policy.is_new = False
            command = decide(pose, np.where(ranges >= RANGE_MAX, np.inf, ranges))
            action = normalized_action(self.robot, torch.tensor([tuple(command)]))
            return observed.set("action", action)

        outcomes = []
        for scenario in self.suite.scenarios(list(indices)):
            policy.is_new = True
            outcomes.append(record_episode(self.env, policy, scenario).outcome)
        return outcomes
