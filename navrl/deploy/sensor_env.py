"""Environment that stands for a robot's sensors: specs for the transforms of a runner."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar, cast

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, Transform

from navrl import keys
from navrl.checks import checked_numbers
from navrl.sim import Lidar, RobotModel
from navrl.transforms import Base
from navrl.worlds.scenario import MAX_PATH_POINTS

Step = TypeVar("Step", bound=Transform)


def read_keys(transforms: Transform) -> set[str]:
    """Return the keys that the steps of a pipeline read."""
    steps = transforms if isinstance(transforms, Compose) else [transforms]
    return {
        key
        for step in steps
        for key in (*(step.in_keys or ()), *getattr(step, "scan_keys", ()))
        if isinstance(key, str)
    }


def steps_of(transforms: Transform, kind: type[Step]) -> list[Step]:
    """Return the steps of a pipeline that are of a class."""
    if isinstance(transforms, kind):
        return [transforms]
    steps = transforms if isinstance(transforms, Compose) else []
    return [found for step in steps for found in steps_of(step, kind)]


def checked_rows(
    given: Mapping[str, tuple[ArrayLike | None, tuple[int, ...]]],
) -> dict[str, Tensor]:
    """Return float32 tensors ``[1, *shape]`` of values and their shapes; zeros for ``None``.

    Raises:
        ValueError: If a value has another shape or is not finite; the message names it.
    """
    values = {}
    for name, (value, shape) in given.items():
        allowed = f"{list(shape)} finite numbers"
        row = np.zeros(shape) if value is None else checked_numbers(name, value, allowed)
        with np.errstate(over="ignore"):
            row = row.astype(np.float32)
        if row.shape != shape or not np.isfinite(row).all():
            raise ValueError(f"{name}={row.tolist()}: must be {allowed}")
        values[name] = torch.from_numpy(row).unsqueeze(0)
    return values


class SensorEnv(EnvBase):
    """Observation and action specs of a robot for the transforms; it is never stepped."""

    def __init__(self, lidar: Lidar, base: Base) -> None:
        """Set the specs of the observations."""
        super().__init__(batch_size=torch.Size([1]))
        self.base, robot = base, cast(RobotModel, base.robot)
        rows = torch.Size((1, robot.command_size))
        observation = {
            keys.RANGES: Bounded(0.0, lidar.max_range, shape=torch.Size((1, lidar.num_beams))),
            keys.POSE: Unbounded(torch.Size((1, 3)), dtype=torch.float64),
            keys.PATH: Unbounded(torch.Size((1, MAX_PATH_POINTS, 2)), dtype=torch.float64),
            keys.VELOCITY: Unbounded(rows),
            keys.COMMAND: Unbounded(rows),
            keys.MOTION_AHEAD: Unbounded(torch.Size((1, 3))),
            keys.VELOCITY_AHEAD: Unbounded(rows),
            keys.SCAN_MOTION: Unbounded(torch.Size((1, 2, 3))),
        }
        if not lidar.coverage.is_full:
            observation[keys.MEASURED] = Binary(
                lidar.num_beams, dtype=torch.bool, shape=torch.Size((1, lidar.num_beams))
            )
        self.observation_spec = Composite(observation, shape=(1,))
        low, high = robot.bounds()
        self.action_spec = Bounded(low.unsqueeze(0), high.unsqueeze(0))
        self.reward_spec = Unbounded(torch.Size((1, 1)))

    def _reset(self, tensordict: TensorDictBase | None, **_: object) -> TensorDictBase:
        raise NotImplementedError("a robot is not reset")

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        raise NotImplementedError("a robot is not stepped")

    def _set_seed(self, seed: int | None) -> None:
        pass
