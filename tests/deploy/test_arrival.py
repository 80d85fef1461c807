"""With another lidar than that of its training, a policy arrives through the control loop."""

import math

import numpy as np
import torch

from navrl.config import compose, instantiate
from navrl.deploy import Controller, SafetyLimits, load_scanner
from navrl.envs.navigation import NavigationEnv
from navrl.evaluation.recorder import record_episode
from navrl.factory import make_env
from navrl.policies import ZOO
from navrl.policies.classical.commands import normalized_action
from navrl.sim import BatchedSimulator, DifferentialDrive, Lidar
from navrl.transforms import compose as compose_steps

STEP_S = 0.2
MOUNT = (0.05, 0.0, math.pi)  # backwards, 5 cm ahead


class Loop:
    """A controller as the policy of a simulated episode of one world."""

    def __init__(self):
        scanner = load_scanner("rplidar_a1", mount=MOUNT, revolution_s=0.0)
        safety = SafetyLimits(min_measured_share=0.0)
        self.control = Controller.from_bundle(ZOO / "navrl-best", scanner, safety=safety)
        self.robot, self.now = DifferentialDrive(), 1000.0
        self.path = None

    def __call__(self, observed):
        pose, path = observed["pose"][0].numpy(), observed["path"][0].numpy()
        self.now += STEP_S
        if self.path is None:
            self.path = path
            self.control.on_path(path)
        ranges = observed["ranges"][0].numpy().astype(np.float64)
        self.control.on_odometry(self.now, pose, self.control.tick(self.now)[:2])
        self.control.on_pose(self.now, pose)
        self.control.on_scan(self.now, np.where(ranges >= 12.0, np.inf, ranges))
        command = torch.tensor([self.control.tick(self.now + 0.001)[:2]])
        return observed.set("action", normalized_action(self.robot, command))


def test_nine_of_ten_episodes_arrive_with_another_lidar():
    lidar = Lidar(
        360, 12.0, noise_amplitude=0.015, mount=MOUNT, angle_min=-math.pi,
        angle_increment=2 * math.pi / 360,
    )  # fmt: skip
    simulator = BatchedSimulator(1, DifferentialDrive(), lidar)
    env = make_env(NavigationEnv(simulator, None, rewards={}, privileged=True), compose_steps())
    suite = instantiate(compose("evaluate", ["suite=table1"]).suite)
    outcomes, loop = [], Loop()
    for scenario in suite.scenarios(list(range(10))):
        loop.path = None
        loop.now += 100.0
        outcomes.append(record_episode(env, loop, scenario).outcome)
    assert outcomes.count("success") >= 9, outcomes
