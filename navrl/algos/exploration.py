"""Exploration noise and its schedule."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, exploration_type

from navrl import keys
from navrl.deprecation import warn


class GaussianExploration:
    """Gaussian noise on normalized actions, annealed linearly over frames.

    Equivalent to TorchRL's :class:`AdditiveGaussianModule`, on any device and without host
    synchronization. TorchRL's schedule loops in Python once per frame; this one computes the scale
    from the frame count, so it is also exact after a resume.

    Args:
        sigma_initial: Noise scale at the first frame, in normalized units.
        sigma_final: Noise scale from ``annealing_frames`` on.
        annealing_frames: Frames over which the scale moves from the first to the second.
        std: Standard deviation of each action dimension, or one number for all of them, multiplied
            by the scale.

    Raises:
        ValueError: If a scale or deviation is negative, or ``annealing_frames`` is not positive.

    Reference:
        The paper does not specify the noise. The authors' precursor uses an Ornstein-Uhlenbeck
        process with a stationary deviation of about 0.23; independent Gaussian noise is simpler and
        more common.
    """

    def __init__(
        self,
        sigma_initial: float = 0.3,
        sigma_final: float = 0.1,
        annealing_frames: int = 1_000_000,
        std: float | Sequence[float] = 1.0,
    ) -> None:
        deviations = list(std) if isinstance(std, Sequence) else [std]
        if min(sigma_initial, sigma_final, *deviations) < 0 or annealing_frames <= 0:
            raise ValueError(
                f"sigma_initial={sigma_initial}, sigma_final={sigma_final}, std={std}: must "
                f"be >= 0; annealing_frames={annealing_frames}: must be > 0"
            )
        self.sigma_initial, self.sigma_final = sigma_initial, sigma_final
        self.annealing_frames = annealing_frames
        self._std = torch.tensor(deviations, dtype=torch.float32)

    @property
    def action_size(self) -> int:
        """Deprecated number of action dimensions."""
        warn("GaussianExploration.action_size", "use the size of the action")
        return len(self._std)

    def sigma(self, frames: int) -> float:
        """Return the noise scale after ``frames`` environment steps."""
        share = min(frames / self.annealing_frames, 1.0)
        return self.sigma_initial + share * (self.sigma_final - self.sigma_initial)

    def __call__(self, tensordict: TensorDictBase, frames: int) -> TensorDictBase:
        """Add noise to ``action`` in place and clip it to [-1, 1], if exploration is enabled."""
        if exploration_type() not in (ExplorationType.RANDOM, None):
            return tensordict
        action = tensordict.get(keys.ACTION).detach()
        if len(self._std) not in (1, action.shape[-1]):
            raise ValueError(
                f"std={self._std.tolist()}: must be one number, or one for each of the "
                f"{action.shape[-1]} dimensions of the action"
            )
        if self._std.device != action.device:
            self._std = self._std.to(action.device)
        noise = torch.randn_like(action) * self._std * self.sigma(frames)
        return tensordict.set(keys.ACTION, (action + noise).clamp(-1.0, 1.0))
