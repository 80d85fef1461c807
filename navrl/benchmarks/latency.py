"""Latency from a scan to a command, as on a robot: one world, one core."""

from __future__ import annotations

import time

import numpy as np
import torch

from navrl import keys
from navrl.benchmarks.measurement import frozen_objects, threads
from navrl.benchmarks.results import Row, at_most
from navrl.deploy import PolicyRunner
from navrl.envs import NavigationEnv

_SENSED = (keys.RANGES, keys.POSE, keys.PATH)
_NUM_WARM_UP = 20


def record_drive(env: NavigationEnv, num_scans: int) -> list[dict[str, np.ndarray]]:
    """Record scan, pose and path of every step of one robot with random actions.

    Args:
        env: Environment with one world and without transforms.
        num_scans: Number of steps.
    """
    generator = torch.Generator().manual_seed(0)
    low, high = env.action_spec.space.low, env.action_spec.space.high
    carrier, seen = env.reset(), []
    for _ in range(num_scans):
        seen.append({key: carrier[key][0].numpy() for key in _SENSED})
        share = torch.rand(low.shape, generator=generator)
        carrier.set(keys.ACTION, low + share * (high - low))
        _, carrier = env.step_and_maybe_reset(carrier)
    return seen


def latency_rows(
    runner: PolicyRunner, drive: list[dict[str, np.ndarray]], repeats: int
) -> list[Row]:
    """Measure the time from arrays to the command for each scan of a drive, on one core.

    Args:
        runner: Policy runner.
        drive: Recorded inputs of :func:`record_drive`.
        repeats: Number of repetitions of the drive.
    """
    with threads(1), frozen_objects():
        for sensed in drive[:_NUM_WARM_UP]:
            runner.act(**sensed)
        runs = np.array(
            [[_milliseconds(runner, sensed) for sensed in drive] for _ in range(repeats)]
        )
    return [
        Row("latency.median", "scan in, command out, 1 core: median", "ms", np.median(runs, 1)),
        Row("latency.p99", "… 99 % within", "ms", np.percentile(runs, 99, axis=1), at_most(3.0)),
    ]


def _milliseconds(runner: PolicyRunner, sensed: dict[str, np.ndarray]) -> float:
    start = time.perf_counter()
    runner.act(**sensed)
    return 1e3 * (time.perf_counter() - start)
