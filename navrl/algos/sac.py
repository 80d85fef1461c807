"""Soft actor-critic (SAC)."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import SACLoss, SoftUpdate

from navrl.algos.distributions import stochastic_policy
from navrl.algos.precision import Precision
from navrl.algos.protocols import NonFiniteUpdateError
from navrl.checks import check_positive

_LOSSES = ("loss_actor", "loss_qvalue", "loss_alpha")
_DEVIATION = 0.37  # before the tanh, at the start


class SAC:
    """Soft actor-critic with TorchRL's loss: two critics and a learned temperature.

    The actor writes the mean action and is what drives and is saved; the distribution around it has
    a deviation that does not depend on the state. Experience is collected with the noise of
    ``exploration``, since the algorithm is off-policy.

    Args:
        actor: Module that writes ``action`` in [-1, 1].
        critic: Module that writes ``state_action_value`` from ``action`` and the observation.
        action_size: Number of action dimensions.
        gamma: Discount factor per step.
        learning_rate: Adam step size of all weights.
        tau: Share of the online weights in the target update after each update.
        max_gradient_norm: The gradient of all weights is clipped to this norm.

    Raises:
        ValueError: If an argument is out of range.

    Reference:
        Haarnoja et al., "Soft Actor-Critic Algorithms and Applications", arXiv 1812.05905.
    """

    def __init__(
        self,
        actor: TensorDictModule,
        critic: TensorDictModule,
        action_size: int = 2,
        gamma: float = 0.98,
        learning_rate: float = 3e-4,
        tau: float = 0.005,
        max_gradient_norm: float = 10.0,
    ) -> None:
        """Check the values, then build loss and optimizer."""
        if not 0 <= gamma <= 1 or not 0 < tau <= 1:
            raise ValueError(f"gamma={gamma}: must be in [0, 1]; tau={tau}: must be in (0, 1]")
        check_positive(learning_rate=learning_rate, max_gradient_norm=max_gradient_norm)
        device = next(actor.parameters()).device
        policy = stochastic_policy(actor, action_size, _DEVIATION, is_learned=True)
        self.actor, self.max_gradient_norm = actor, max_gradient_norm
        self.precision = Precision("float32", device)
        entropy = -float(action_size)
        self.loss = SACLoss(policy, critic, target_entropy=entropy, deactivate_vmap=True).to(device)
        self.loss.make_value_estimator(gamma=gamma)
        self.target_update = SoftUpdate(self.loss, tau=tau)
        self._weights = [value for value in self.loss.parameters() if value.requires_grad]
        self.optimizer = torch.optim.Adam(self._weights, learning_rate)

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step on actor, critics and temperature, and update the targets.

        Args:
            batch: ``[B]`` transitions.

        Returns:
            Detached scalars: the losses, the temperature ``alpha``, the ``entropy`` and the
            gradient norm before clipping.

        Raises:
            NonFiniteUpdateError: If a scalar is NaN or infinite; no weight has changed.
        """
        terms = self.loss(batch)
        self.optimizer.zero_grad()
        torch.stack([terms[name] for name in _LOSSES]).sum().backward()
        norm = torch.nn.utils.clip_grad_norm_(self._weights, self.max_gradient_norm)
        found = {name: terms[name] for name in (*_LOSSES, "alpha", "entropy")}
        scalars = {name: value.detach().mean() for name, value in found.items()}
        scalars["gradient_norm"] = norm.detach()
        if not torch.stack(list(scalars.values())).isfinite().all():
            raise NonFiniteUpdateError(scalars, batch)
        self.optimizer.step()
        self.target_update.step()
        return scalars

    def update_from_each(self, batches: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step per batch of ``[K, B]``; return sums of the scalars."""
        scalars = [self.update(batch) for batch in batches.unbind(0)]
        return {name: torch.stack([each[name] for each in scalars]).sum() for name in scalars[0]}

    def anneal(self, share_done: float) -> None:
        """Retain the learning rate."""

    def state_dict(self) -> dict[str, Any]:
        """Return weights, target weights and the state of the optimizer."""
        return {"loss": self.loss.state_dict(), "optimizer": self.optimizer.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a copy of a state of :meth:`state_dict`."""
        copied = deepcopy(dict(state))
        self.loss.load_state_dict(copied["loss"])
        self.optimizer.load_state_dict(copied["optimizer"])
