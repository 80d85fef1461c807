"""Regularization of an actor towards smooth actions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor


@dataclass(frozen=True)
class ActionSmoothness:
    """Penalty on an actor whose actions differ between similar or successive observations.

    With replayed n-step returns the next observation is n steps later, so the temporal term is of
    the change over n steps; the spatial term does not depend on it.

    Args:
        temporal: Weight of the squared distance between the actions at an observation and at the
            next one.
        spatial: Weight of the squared distance between the actions at an observation and at a copy
            with noise.
        noise: Standard deviation of that noise, in units of the networks' inputs, which are scaled
            to about [-1, 1].

    Raises:
        ValueError: If a value is negative or not finite.

    Example:
        >>> from torch import nn
        >>> actor = TensorDictModule(nn.Linear(1, 1), ["position"], ["action"])
        >>> _ = nn.init.ones_(actor.module.weight)
        >>> step = {"position": torch.zeros(5, 1), "next": {"position": torch.ones(5, 1)}}
        >>> from tensordict import TensorDict
        >>> batch = TensorDict(step, 5)
        >>> penalty = ActionSmoothness(temporal=0.5)
        >>> float(penalty(actor, batch, actor(batch)["action"]).detach())
        0.5

    Reference:
        Mysore et al., "Regularizing Action Policies for Smooth Control with Reinforcement
        Learning", 2021 (CAPS), which weights distances that are not squared.
    """

    temporal: float = 0.0
    spatial: float = 0.0
    noise: float = 0.05

    def __post_init__(self) -> None:
        """Check the weights."""
        for name, value in vars(self).items():
            if not 0.0 <= value < math.inf:
                raise ValueError(f"action_smoothness.{name}={value}: must be >= 0")

    @property
    def is_active(self) -> bool:
        """Return whether a weight is positive; otherwise nothing is computed."""
        return self.temporal > 0.0 or self.spatial > 0.0

    def __call__(self, actor: TensorDictModule, batch: TensorDictBase, action: Tensor) -> Tensor:
        """Return the weighted penalty, a scalar, the mean over a batch.

        Args:
            actor: Actor with gradients.
            batch: ``[B]`` transitions.
            action: ``[B, C]``, the actor's actions at their start.
        """
        total = action.new_zeros(())
        observed = [batch.get(key) for key in actor.in_keys]
        if self.temporal:
            following = [batch.get(("next", key)) for key in actor.in_keys]
            total = total + self.temporal * _distance(actor, following, action)
        if self.spatial:
            noisy = [value + self.noise * torch.randn_like(value) for value in observed]
            total = total + self.spatial * _distance(actor, noisy, action)
        return total


def _distance(actor: TensorDictModule, inputs: Sequence[Tensor], action: Tensor) -> Tensor:
    """Return the mean squared distance of the actor's actions at ``inputs`` to ``action``."""
    return (actor.module(*inputs) - action).float().square().sum(-1).mean()
