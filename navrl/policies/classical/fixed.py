"""Controllers that look at nothing."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from navrl import keys
from navrl.sim import DifferentialDrive


class StandStill(TensorDictModuleBase):
    """Never move.

    Args:
        robot: Whose limits scale the action.

    Raises:
        ValueError: If the robot cannot stand still.
    """

    def __init__(self, robot: DifferentialDrive) -> None:
        super().__init__()
        if not robot.min_speed <= 0 <= robot.max_speed:
            raise ValueError(f"robot: min_speed={robot.min_speed} does not allow standing still")
        self.in_keys, self.out_keys = [], [keys.ACTION]
        self._speed = -(robot.max_speed + robot.min_speed) / (robot.max_speed - robot.min_speed)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalised action ``[*B, 2]``."""
        action = torch.zeros(*tensordict.batch_size, 2, device=tensordict.device)
        action[..., 0] = self._speed
        return tensordict.set(keys.ACTION, action)


class UniformRandom(TensorDictModuleBase):
    """Draw each action uniformly within the limits.

    All worlds share one stream of draws: an episode is the same again only beside the same others.

    Args:
        robot: Unused; taken so that all classical controllers are built alike.
        seed: Of the controller's own generator.
    """

    def __init__(self, robot: DifferentialDrive | None = None, seed: int = 0) -> None:
        super().__init__()
        self.in_keys, self.out_keys = [], [keys.ACTION]
        self._generator = torch.Generator().manual_seed(seed)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalised action ``[*B, 2]``."""
        shape = (*tensordict.batch_size, 2)
        action = torch.rand(shape, generator=self._generator) * 2 - 1
        return tensordict.set(keys.ACTION, action.to(tensordict.device))
