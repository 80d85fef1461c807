"""Both simulators return the walls of a world as its scenario has them."""

import numpy as np
import pytest
import torch

from navrl.sim import BatchedSimulator, DifferentialDrive, Lidar
from navrl.sim.bullet import BulletSimulator
from navrl.worlds import Scenario, ScenarioBatch

WALLS = [[(1.0, 2.0, 0.5, 0.1, 0.3), (4.0, 0.0, 0.1, 1.0, -2.0)], [(0.0, 3.0, 2.0, 0.1, 0.0)]]


def scenario(walls):
    return Scenario(
        suite="by hand",
        seed=0,
        index=0,
        kind="corridor",
        boxes=np.array(walls),
        start=np.zeros(3),
        goal=np.array([9.0, 0.0]),
        path=np.array([[0.0, 0.0], [9.0, 0.0]]),
        pedestrians=(),
        noise_seed=0,
    )


@pytest.mark.parametrize("kind", [BatchedSimulator, BulletSimulator])
def test_walls_equal_the_scenarios(kind):
    simulator = kind(2, DifferentialDrive(), Lidar(num_beams=8))
    with pytest.raises(RuntimeError, match="must be reset"):
        simulator.walls(0)
    simulator.reset(torch.arange(2), ScenarioBatch.pack([scenario(walls) for walls in WALLS]))
    for world, walls in enumerate(WALLS):
        np.testing.assert_allclose(simulator.walls(world), walls, atol=1e-12)
    simulator.close()
