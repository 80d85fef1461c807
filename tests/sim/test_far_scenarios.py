"""Scenarios far from the origin, where float32 poses are coarse, are refused."""

import numpy as np
import pytest
import torch
from scenes import pack, scene

from navrl.sim import BatchedSimulator, DifferentialDrive, Lidar
from navrl.sim.bullet import BulletSimulator
from navrl.sim.reset_checks import FARTHEST_M


@pytest.fixture(params=[BatchedSimulator, BulletSimulator])
def simulator(request):
    simulator = request.param(1, DifferentialDrive(), Lidar(num_beams=8))
    yield simulator
    simulator.close()


@pytest.mark.parametrize(
    "start", [(10_001, 0, 0), (0, -10_001, 0), (5e5, 5.6e6, 0), (np.nan, 0, 0)]
)
def test_start_beyond_ten_kilometers_is_rejected(simulator, start):
    with pytest.raises(ValueError, match=r"scenarios\.start: must be finite and within 10000 m"):
        simulator.reset(torch.arange(1), pack(scene(start=start)))


def test_pose_at_the_limit_is_exact_to_a_millimeter(simulator):
    x, wall = FARTHEST_M - 0.3, (FARTHEST_M + 0.8, 0.0, 0.1, 1.0, 0.0)
    simulator.reset(torch.arange(1), pack(scene([wall], start=(x, 0.0, 0.0))))
    assert abs(float(simulator.state().pose[0, 0]) - x) < 1e-3
    assert abs(float(simulator.ranges()[0, 0]) - 1.0) < 5e-3
