"""TorchRL's SAC loss with weights bound to network copies once, see :mod:`bound_losses`."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import SACLoss
from torchrl.objectives.sac import compute_rsample_log_prob
from torchrl.objectives.utils import distance_loss

from navrl.algos.bound_networks import TwinCritics, bind, q_value
from navrl.keys import ACTION


class BoundSACLoss(SACLoss):
    """Faster equivalent of :class:`torchrl.objectives.SACLoss` with two critics.

    A critic with ``encode`` and ``q_value`` encodes an observation once for both losses.

    Args:
        policy: Policy with a distribution.
        critic: Module that writes ``state_action_value``; two critics are created from it.
        initial_temperature: Weight of the entropy at the start.
        target_entropy: Entropy that the temperature is learned for, nats.
    """

    log_alpha: Tensor

    def __init__(
        self,
        policy: ProbabilisticActor,
        critic: TensorDictModule,
        initial_temperature: float,
        target_entropy: float,
    ) -> None:
        """Build TorchRL's loss."""
        super().__init__(
            policy,
            critic,
            alpha_init=initial_temperature,
            target_entropy=target_entropy,
            deactivate_vmap=True,  # autocast has no effect within vmap on the CPU
        )
        self._bound: tuple[ProbabilisticActor, TwinCritics] | None = None

    def _bind(self) -> tuple[ProbabilisticActor, TwinCritics]:
        """Return policy and critics."""
        if self._bound is None:
            self._bound = (
                bind(cast(ProbabilisticActor, self.actor_network), self.actor_network_params),
                TwinCritics(
                    self.qvalue_network,
                    self.qvalue_network_params,
                    self.target_qvalue_network_params,
                ),
            )
        policy, critics = self._bound
        critics.renew()
        return policy, critics

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the losses and their terms; ``td_error`` is written into the batch.

        Args:
            tensordict: ``[B]`` transitions.

        Returns:
            Scalars ``loss_actor``, ``loss_qvalue``, ``loss_alpha``, ``alpha`` and ``entropy``.
        """
        policy, critics = self._bind()
        alpha = self.log_alpha.detach().exp()
        with torch.no_grad():
            next_value = _soft_value(policy, critics, tensordict.get("next"), alpha)
            target_value = self._target_value(tensordict, next_value)
        encoded = critics.encode(tensordict)
        values = critics.values(encoded, tensordict.get(ACTION))
        loss_qvalue = distance_loss(
            values, target_value.expand_as(values), loss_function=self.loss_function
        )
        td_error = (values - target_value).detach().abs()
        tensordict.set(self.tensor_keys.priority, td_error.amax(0))
        action, log_prob = _sample(policy, tensordict)
        pairs = zip(critics.frozen, encoded, strict=True)
        judged = [q_value(c, [part.detach() for part in parts], action) for c, parts in pairs]
        loss_actor = alpha * log_prob - torch.minimum(*judged).squeeze(-1)
        log_prob = log_prob.detach()
        return TensorDict(
            {
                "loss_actor": loss_actor.mean(),
                "loss_qvalue": loss_qvalue.sum(0).mean(),
                "loss_alpha": self.alpha_loss(log_prob).mean(),
                "alpha": alpha,
                "entropy": -log_prob.mean(),
            },
            [],
        )

    def _target_value(self, tensordict: TensorDictBase, next_value: Tensor) -> Tensor:
        """Return the targets of Q ``[B]``."""
        # TorchRL's estimator reads the value from the transition.
        with_value = tensordict.copy()
        with_value.set(("next", self.value_estimator.tensor_keys.value), next_value)
        return self.value_estimator.value_estimate(with_value).squeeze(-1)


def _soft_value(
    policy: ProbabilisticActor, critics: TwinCritics, tensordict: TensorDictBase, alpha: Tensor
) -> Tensor:
    """Return the value ``[B, 1]`` of a sampled action by the target critics."""
    action, log_prob = _sample(policy, tensordict)
    return critics.least_target(tensordict, action) - alpha * log_prob.unsqueeze(-1)


def _sample(policy: ProbabilisticActor, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Return actions ``[B, C]`` and their log-probabilities ``[B]``."""
    return compute_rsample_log_prob(policy.get_dist(tensordict.select(*policy.in_keys)))
