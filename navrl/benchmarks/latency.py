"""From a scan to a command, as on a robot: one world, one core."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from navrl import keys
from navrl.benchmarks.measurement import threads
from navrl.benchmarks.results import Row, at_most
from navrl.envs import NavigationEnv

_SENSED = (keys.RANGES, keys.POSE, keys.PATH)
_NUM_WARM_UP = 20


def record_drive(env: NavigationEnv, num_scans: int) -> list[dict[str, np.ndarray]]:
    """Return the scan, pose and path of every step of a random drive of one robot.

    Args:
        env: One world, without transforms.
        num_scans: Steps to record.
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


class Robot:
    """Turn what a robot senses into (v, w), carrying the past from scan to scan.

    Args:
        transforms: From raw observations to network inputs.
        actor: Writes an action in [-1, 1].
        low: ``[2]`` smallest command, m/s and rad/s.
        high: ``[2]`` largest command.
    """

    def __init__(
        self,
        transforms: Transform,
        actor: Callable[[TensorDictBase], TensorDictBase],
        low: Tensor,
        high: Tensor,
    ) -> None:
        self.transforms, self.actor = transforms, actor
        self._middle, self._half = (low + high) / 2, (high - low) / 2
        self._past: TensorDictBase | None = None

    @torch.no_grad()
    def act(self, sensed: dict[str, np.ndarray]) -> np.ndarray:
        """Return the command ``[2]`` (v, w) for one scan, its pose and the path."""
        now = TensorDict({k: torch.from_numpy(v).unsqueeze(0) for k, v in sensed.items()}, [1])
        if self._past is None:
            now = self.transforms._reset(now, now)
        else:
            now = self.transforms._step(self._past, now)
        self._past = now
        action = self.actor(now)[keys.ACTION][0]
        return (self._middle + self._half * action).numpy()


def latency_rows(robot: Robot, drive: list[dict[str, np.ndarray]], repeats: int) -> list[Row]:
    """Measure each scan of a drive, from arrays to the command, on one core.

    Args:
        robot: What acts.
        drive: What it senses.
        repeats: Times that the drive is played.
    """
    with threads(1):
        for sensed in drive[:_NUM_WARM_UP]:
            robot.act(sensed)
        runs = np.array(
            [[_milliseconds(robot, sensed) for sensed in drive] for _ in range(repeats)]
        )
    return [
        Row("latency.median", "scan in, command out, 1 core: median", "ms", np.median(runs, 1)),
        Row("latency.p99", "… 99 % within", "ms", np.percentile(runs, 99, axis=1), at_most(3.0)),
    ]


def _milliseconds(robot: Robot, sensed: dict[str, np.ndarray]) -> float:
    start = time.perf_counter()
    robot.act(sensed)
    return 1e3 * (time.perf_counter() - start)
