"""A day of simulated control shows no growth of memory.

The long one is ``python -m pytest --run-slow tests/deploy/test_soak.py``; ``NAVRL_SOAK_TICKS`` sets
its number of ticks. Its figures are printed with ``-s``.
"""

import gc
import math
import os
import resource
import time
from pathlib import Path

import numpy as np
import pytest

from navrl.deploy import Controller, DriveState
from navrl.policies import ZOO

DAY = 24 * 3600 * 5  # ticks at 5 Hz
BEARING = -np.pi + np.arange(360) * 2 * np.pi / 360


def resident_mb():
    """Return the memory of this process that is in use, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def soak(control, ticks):
    """Drive along corridors; return the memory at a fifth and at the end, MB, and the states."""
    random, memory, states = np.random.default_rng(0), [], {}
    pose, now = np.zeros(3), 0.0
    path = np.stack((np.linspace(0.0, 20.0, 401), np.zeros(401)), -1)
    for tick in range(ticks):
        now = 0.2 * tick
        if tick % 200 == 0:
            pose[:] = 0.0
            control.on_path(path)
        if tick % 1000 == 500:
            now += 1.0  # a pause
        side = np.where(np.sin(BEARING + pose[2]) > 0, 1.5 - pose[1], 1.5 + pose[1])
        ranges = side / np.abs(np.sin(BEARING + pose[2])).clip(0.15)
        control.on_scan(now - 0.19, ranges + random.normal(0.0, 0.01, 360))
        control.on_pose(now, pose)
        control.on_odometry(now, pose, (0.0, 0.0))
        v, w, state = control.tick(now)
        states[state] = states.get(state, 0) + 1
        pose += 0.2 * np.array([v * math.cos(pose[2]), v * math.sin(pose[2]), w])
        pose[1] = np.clip(pose[1], -1.0, 1.0)
        pose[2] = (pose[2] + math.pi) % (2 * math.pi) - math.pi
        if tick + 1 in (ticks // 5, ticks):
            gc.collect()
            memory.append(resident_mb())
    return memory, states


def check(ticks, growth_mb):
    control = Controller.from_bundle(ZOO / "paper", "rplidar_a1")
    control.warm_up()
    start = time.perf_counter()
    memory, states = soak(control, ticks)
    took = time.perf_counter() - start
    print(f"\n{ticks} ticks, {took:.0f} s: {memory[0]:.1f} MB, {memory[1]:.1f} MB, {states}")
    assert memory[1] - memory[0] < growth_mb
    assert states[DriveState.DRIVE] > 0.5 * ticks
    assert len(control._inputs.odometry) < 100 and len(control._inputs.commanded) < 100


def test_control_of_minutes_does_not_grow():
    check(400, 5.0)


@pytest.mark.slow
def test_control_of_a_day_does_not_grow():
    check(int(os.environ.get("NAVRL_SOAK_TICKS", DAY)), 5.0)
