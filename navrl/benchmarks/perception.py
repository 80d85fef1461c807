"""Speed of ICP and TAGD on scans of a drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from tensordict import TensorDictBase
from torchrl.envs import Transform, TransformedEnv

from navrl.benchmarks.measurement import Budget, Task, alternate
from navrl.benchmarks.results import Row, at_most
from navrl.benchmarks.stepping import RandomDrive

_NUM_STEPS = 8


def perception_rows(
    env: TransformedEnv, variants: Mapping[str, tuple[Transform, Transform]], budget: Budget
) -> list[Row]:
    """Measure alignment and grouping of one scan on one core.

    Args:
        env: Environment; scans are those of the last step of a short random drive in all worlds.
        variants: ICP and TAGD transforms by name.
        budget: Duration and number of measurements.
    """
    scans = record_scans(env)
    tasks = {name: Task(_work(scans, *pair)) for name, pair in variants.items()}
    rates = alternate(tasks, budget)
    return [
        Row(f"icp_tagd.{name}", f"ICP ({name}) + TAGD, 1 core", "µs", 1e6 / rate, at_most(30.0))
        for name, rate in rates.items()
    ]


def record_scans(env: TransformedEnv) -> TensorDictBase:
    """Return the transforms' inputs after some random steps."""
    drive = RandomDrive(env)
    for _ in range(_NUM_STEPS):
        drive()
    return drive.carrier


def _work(scans: TensorDictBase, icp: Transform, tagd: Transform) -> Callable[[], int]:
    def work() -> int:
        with torch.no_grad():
            tagd(icp(scans.copy()))
        return len(scans)

    return work
