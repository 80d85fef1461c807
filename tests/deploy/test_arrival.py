"""With another lidar than that of its training, a policy arrives through the control loop."""

import math

import pytest
from simulated_a1 import STEP_S, SimulatedA1

from navrl.deploy import Controller, SafetyLimits, load_scanner
from navrl.policies import ZOO

MOUNT = (0.05, 0.0, math.pi)  # backwards, 5 cm ahead


@pytest.mark.slow
def test_nine_of_ten_episodes_arrive_with_another_lidar():
    scanner = load_scanner("rplidar_a1", mount=MOUNT, revolution_s=0.0)
    safety = SafetyLimits(min_measured_share=0.0)
    control = Controller.from_bundle(ZOO / "navrl-best", scanner, safety=safety)
    now = [1000.0]

    def start(path):
        now[0] += 100.0
        control.on_path(path)

    def decide(pose, ranges):
        now[0] += STEP_S
        control.on_odometry(now[0], pose, control.tick(now[0])[:2])
        control.on_pose(now[0], pose)
        control.on_scan(now[0], ranges)
        return control.tick(now[0] + 0.001)[:2]

    outcomes = SimulatedA1(MOUNT).outcomes(range(10), start, decide)
    assert outcomes.count("success") >= 9, outcomes
