"""Controllers without observations."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

from navrl import keys
from navrl.policies.controller import Controller
from navrl.sim import DifferentialDrive
from navrl.worlds import ScenarioBatch

_WEYL = (
    0x9E3779B1  # odd, so that seeds differ in all 32 bits; torch's CPU generator reads no others
)


class StandStill(Controller):
    """Controller that never moves.

    Args:
        robot: Robot whose limits scale the action.

    Raises:
        ValueError: If the robot cannot stand still.
    """

    def __init__(self, robot: DifferentialDrive) -> None:
        super().__init__()
        if not robot.min_speed <= 0 <= robot.max_speed:
            raise ValueError(f"robot.min_speed={robot.min_speed}: must be <= 0, to stand still")
        self.in_keys, self.out_keys = [], [keys.ACTION]
        self._speed = -(robot.max_speed + robot.min_speed) / (robot.max_speed - robot.min_speed)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[*B, 2]``."""
        action = torch.zeros(*tensordict.batch_size, 2, device=tensordict.device)
        action[..., 0] = self._speed
        return tensordict.set(keys.ACTION, action)


class UniformRandom(Controller):
    """Draw each action uniformly within the limits.

    After :meth:`prepare` each world has its own random stream, determined by its scenario, so that
    an episode does not depend on other episodes. Before, all worlds share one stream.

    Args:
        robot: Unused; accepted so that all classical controllers have the same interface.
        seed: Seed of the controller's own generator.
    """

    def __init__(self, robot: DifferentialDrive | None = None, seed: int = 0) -> None:
        super().__init__()
        self.in_keys, self.out_keys = [], [keys.ACTION]
        self._seed = seed
        self._generators = [torch.Generator().manual_seed(seed)]

    def prepare(self, scenarios: ScenarioBatch) -> None:
        """Start the random stream of each scenario's episode."""
        shift = _WEYL * self._seed
        seeds = [(noise + shift) % 2**32 for noise in scenarios.noise_seed.tolist()]
        self._generators = [torch.Generator().manual_seed(seed) for seed in seeds]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[*B, 2]``."""
        if list(tensordict.batch_size) == [len(self._generators)]:
            draws = torch.stack([torch.rand(2, generator=own) for own in self._generators])
        else:
            draws = torch.rand((*tensordict.batch_size, 2), generator=self._generators[0])
        return tensordict.set(keys.ACTION, (draws * 2 - 1).to(tensordict.device))
