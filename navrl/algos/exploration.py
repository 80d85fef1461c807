"""Exploration noise and its schedule."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, exploration_type

from navrl import keys
from navrl.deprecation import warn

MAX_MEAN = 0.999
"""Largest mean of an action under noise before the tanh, whose inverse is infinite at 1."""


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

    Attributes:
        state_keys: Entries of the TensorDict that the noise carries from step to step.

    Reference:
        The paper does not specify the noise. The authors' precursor uses an Ornstein-Uhlenbeck
        process with a stationary deviation of about 0.23; independent Gaussian noise is simpler and
        more common.
    """

    state_keys: tuple[str, ...] = ()

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
        noise = self._unit_noise(tensordict, action) * self._std * self.sigma(frames)
        return tensordict.set(keys.ACTION, self._disturbed(action, noise))

    def _disturbed(self, action: Tensor, noise: Tensor) -> Tensor:
        """Return the action ``[N, C]`` in [-1, 1] with noise of the same shape."""
        return (action + noise).clamp(-1.0, 1.0)

    def _unit_noise(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return noise ``[N, C]`` of zero mean and unit variance."""
        return torch.randn_like(action)


class SquashedExploration(GaussianExploration):
    """Gaussian noise before the tanh, as in the distribution of PPO.

    No action is clipped, so each has a finite probability density. Arguments are those of
    :class:`GaussianExploration`, whose scale is that before the tanh.
    """

    def _disturbed(self, action: Tensor, noise: Tensor) -> Tensor:
        return torch.tanh(torch.atanh(action.clamp(-MAX_MEAN, MAX_MEAN)) + noise)


class CorrelatedExploration(GaussianExploration):
    """Gaussian noise that is correlated over time, a first-order autoregressive process.

    Between two steps the noise keeps the share a = exp(-time_step_s / correlation_time_s) of its
    value and gains white noise of variance 1 - a^2, so that its deviation is ``sigma`` in every
    step. Each world has its own noise, which restarts with each episode. It is a key of the
    TensorDict, ``exploration_noise``, so checkpoints include it.

    Args:
        correlation_time_s: Time after which the autocorrelation is 1 / e, s; 0 is white noise.
        time_step_s: Time between two actions, s.
        **schedule: Arguments of :class:`GaussianExploration`.

    Raises:
        ValueError: If ``correlation_time_s`` is negative, ``time_step_s`` is not positive, or an
            argument of :class:`GaussianExploration` is out of range.

    Example:
        >>> from tensordict import TensorDict
        >>> noise = CorrelatedExploration(correlation_time_s=0.4, sigma_initial=0.1)
        >>> worlds = TensorDict({"action": torch.zeros(4, 2)}, 4)
        >>> noise(worlds, frames=0)["exploration_noise"].shape
        torch.Size([4, 2])

    Reference:
        The discretized process of Uhlenbeck and Ornstein (1930), as in Lillicrap et al. (2016).
    """

    state_keys = (keys.EXPLORATION_NOISE,)

    def __init__(
        self, correlation_time_s: float = 0.4, time_step_s: float = 0.2, **schedule: Any
    ) -> None:
        """Check the process; ``schedule`` holds the arguments of the base class."""
        super().__init__(**schedule)
        if not 0.0 <= correlation_time_s < math.inf or not 0.0 < time_step_s < math.inf:
            raise ValueError(
                f"correlation_time_s={correlation_time_s}: must be >= 0; "
                f"time_step_s={time_step_s}: must be > 0"
            )
        decays = correlation_time_s > 0.0
        self._kept = math.exp(-time_step_s / correlation_time_s) if decays else 0.0

    def _unit_noise(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        noise = torch.randn_like(action)
        last = tensordict.get(keys.EXPLORATION_NOISE, None)
        if last is not None:
            gain = math.sqrt(1.0 - self._kept**2)
            noise = torch.where(last.isnan(), noise, self._kept * last + gain * noise)
        tensordict.set(keys.EXPLORATION_NOISE, noise)
        return noise
