"""What is compared with PyBullet, navground and ir-sim: the work done, never the speed."""

import math
from unittest import mock

import numpy as np
import pytest
import torch

from navrl.benchmarks import Budget, alternate
from navrl.benchmarks.peers import IrSim, Navground
from navrl.benchmarks.scanning import scan_task
from navrl.benchmarks.scenes import ROOM_HALF_SIZE, WALKER, clutter
from navrl.sim import BatchedSimulator, BulletSimulator, DifferentialDrive, Lidar
from navrl.sim.bullet_scene import Scene

BULLET, BATCHED = BulletSimulator, BatchedSimulator


def simulator(kind, num_worlds):
    return kind(num_worlds, DifferentialDrive(), Lidar(noise="none"), max_pedestrians=1)


def test_bullet_casts_the_rays_of_each_counted_scan():
    bullet = simulator(BULLET, 2)
    task = scan_task(bullet, clutter(2, 32))
    counted, work = 0, task.work

    def count():
        nonlocal counted
        done = work()
        counted += done
        return done

    with mock.patch.object(Scene, "scan", autospec=True, side_effect=Scene.scan) as scan:
        alternate({"scan": type(task)(count, 1, task.prepare)}, Budget(1e-9, 3))
    bullet.close()
    assert counted == scan.call_count == 2 * 4


@pytest.mark.parametrize("kind", [BULLET, BATCHED])
@pytest.mark.parametrize("num_worlds", [1, 3])
def test_robots_move_between_two_scans(kind, num_worlds):
    worlds = simulator(kind, num_worlds)
    task = scan_task(worlds, clutter(num_worlds, 32))
    seen = []
    for _ in range(3):
        task.prepare()
        assert task.work() == num_worlds
        seen.append(worlds.ranges().clone())
    worlds.close()
    for before, after in zip(seen, seen[1:], strict=False):
        assert (before != after).any(dim=-1).all()
    assert torch.isfinite(torch.stack(seen)).all()


@pytest.mark.parametrize(("peer", "module"), [(Navground, "navground"), (IrSim, "irsim")])
def test_peers_have_walls_around_the_robot(peer, module):
    pytest.importorskip(module, reason="a peer of the benchmark")
    world, scans = peer(), []
    for _ in range(2):
        assert world() == 1
        scans.append(world.ranges())
    check_readings(*scans)


def check_readings(first, second):
    """The walls' distance in every direction, unless a walker hides them; walkers move."""
    angles = np.linspace(0, 2 * math.pi, len(first), endpoint=False)
    wall = ROOM_HALF_SIZE / np.maximum(abs(np.cos(angles)), abs(np.sin(angles)))
    for ranges in (first, second):
        free = np.abs(ranges - np.minimum(wall, 3.5)) < 0.02
        assert free.mean() > 0.4  # ten walkers hide the rest
        assert (ranges < wall + 0.02).all() and (ranges > WALKER).all()
    assert (first != second).any()
