"""TorchRL's DDPG and TD3 losses with weights bound to network copies once.

TorchRL's losses swap each set of weights (online, detached, target) into a network for every call,
which takes a tenth of an update for the networks of navrl, and more with two critics. Weights only
change in place, so one copy of the network per set, bound to its weights once, is equivalent.

A critic with ``encode`` and ``q_value`` (:class:`navrl.networks.CriticNetwork`) encodes an
observation once for both losses, because the actor's loss needs no gradient of the encoder.
"""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.objectives import DDPGLoss, TD3Loss
from torchrl.objectives.utils import distance_loss

from navrl.algos.action_smoothness import ActionSmoothness
from navrl.algos.bound_networks import TwinCritics, bind, call, encode, q_value
from navrl.keys import ACTION


class BoundDDPGLoss(DDPGLoss):
    """Faster equivalent of :class:`torchrl.objectives.DDPGLoss`.

    Args:
        actor: Module that writes ``action``.
        critic: Module that writes ``state_action_value``. Both modules hold one network, which is
            called with the values of their ``in_keys``.
        loss_function: As in TorchRL.
    """

    def __init__(
        self, actor: TensorDictModule, critic: TensorDictModule, loss_function: str
    ) -> None:
        super().__init__(
            actor, critic, loss_function=loss_function, delay_actor=True, delay_value=True
        )
        self.smoothness = ActionSmoothness()  # no penalty
        self._bound: tuple[TensorDictModule, ...] = ()

    def _bind(self) -> tuple[TensorDictModule, ...]:
        """Return actor, target actor, critic, critic without gradient and target critic.

        The networks are bound at the first call, because TorchRL warns about targets that are read
        before an updater exists. They are stored in a tuple, because modules stored as attributes
        would add their weights to the ``state_dict`` twice.
        """
        if not self._bound:
            self._bound = (
                bind(self.actor_network, self.actor_network_params),
                bind(self.actor_network, self.target_actor_network_params),
                bind(self.value_network, self.value_network_params),
                bind(self.value_network, self.value_network_params.detach()),
                bind(self.value_network, self.target_value_network_params),
            )
        return self._bound

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the losses and their terms; ``td_error`` is written into the batch.

        Args:
            tensordict: ``[B]`` transitions.

        Returns:
            Scalars ``loss_actor`` and ``loss_value``; ``pred_value``, ``target_value`` and
            ``td_error`` ``[B]``.
        """
        actor, target_actor, critic, frozen_critic, target_critic = self._bind()
        with torch.no_grad():
            following = tensordict.get("next")
            action = call(target_actor, following)
            next_value = q_value(target_critic, encode(target_critic, following), action)
            target_value = self.value_estimator.value_estimate(tensordict, next_value=next_value)
        target_value = target_value.squeeze(-1)
        encoded = encode(critic, tensordict)
        value = q_value(critic, encoded, tensordict.get(ACTION)).squeeze(-1)
        loss_value = distance_loss(value, target_value, loss_function=self.loss_function)
        without_gradient = tuple(part.detach() for part in encoded)
        policy_action = call(actor, tensordict)
        policy_value = q_value(frozen_critic, without_gradient, policy_action)
        loss_actor = -policy_value.mean()
        if self.smoothness.is_active:
            loss_actor = loss_actor + self.smoothness(actor, tensordict, policy_action)
        td_error = (value - target_value).detach().square()
        tensordict.set(self.tensor_keys.priority, td_error)
        return TensorDict(
            {
                "loss_actor": loss_actor,
                "loss_value": loss_value.mean(),
                "pred_value": value,
                "target_value": target_value,
                "td_error": td_error,
            },
            [],
        )


class BoundTD3Loss(TD3Loss):
    """Faster equivalent of :class:`torchrl.objectives.TD3Loss`.

    Args:
        actor: As in :class:`BoundDDPGLoss`.
        critic: As in :class:`BoundDDPGLoss`; two critics are created from it.
        loss_function: As in TorchRL.
        target_noise: Standard deviation of the noise on target actions.
        target_noise_clip: Largest absolute noise on target actions.
    """

    def __init__(
        self,
        actor: TensorDictModule,
        critic: TensorDictModule,
        loss_function: str,
        target_noise: float,
        target_noise_clip: float,
    ) -> None:
        super().__init__(
            actor,
            critic,
            bounds=(-1.0, 1.0),
            policy_noise=target_noise,
            noise_clip=target_noise_clip,
            loss_function=loss_function,
            deactivate_vmap=True,  # autocast has no effect within vmap on the CPU
        )
        self.smoothness = ActionSmoothness()  # no penalty
        self._bound: tuple[TensorDictModule, TensorDictModule, TwinCritics] | None = None

    def _bind(self) -> tuple[TensorDictModule, TensorDictModule, TwinCritics]:
        """Return actor, target actor and critics."""
        if self._bound is None:
            self._bound = (
                bind(self.actor_network, self.actor_network_params),
                bind(self.actor_network, self.target_actor_network_params),
                TwinCritics(
                    self.qvalue_network,
                    self.qvalue_network_params,
                    self.target_qvalue_network_params,
                ),
            )
        self._bound[2].renew()
        return self._bound

    def forward(self, tensordict: TensorDictBase, with_actor: bool = True) -> TensorDictBase:
        """Return the losses and their terms; ``td_error`` is written into the batch.

        Args:
            tensordict: ``[B]`` transitions.
            with_actor: Whether to compute the actor's loss.

        Returns:
            Scalars ``loss_qvalue`` and, if requested, ``loss_actor``; ``pred_value`` ``[2, B]`` and
            ``target_value`` ``[B]``.
        """
        actor, target_actor, critics = self._bind()
        action = tensordict.get(ACTION)
        noise = (torch.randn_like(action) * self.policy_noise).clamp(
            -self.noise_clip, self.noise_clip
        )
        with torch.no_grad():
            following = tensordict.get("next")
            next_action = call(target_actor, following) + noise
            next_action = next_action.clamp(self.min_action, self.max_action)
            next_value = critics.least_target(following, next_action)
            target_value = self.value_estimator.value_estimate(tensordict, next_value=next_value)
        target_value = target_value.squeeze(-1)
        encoded = critics.encode(tensordict)
        values = critics.values(encoded, action)
        losses = distance_loss(
            values, target_value.expand_as(values), loss_function=self.loss_function
        )
        td_error = (values - target_value).detach().square()
        tensordict.set(self.tensor_keys.priority, td_error.amax(0))
        terms = {
            "loss_qvalue": losses.sum(0).mean(),
            "pred_value": values.detach(),
            "target_value": target_value,
        }
        if with_actor:
            without_gradient = tuple(part.detach() for part in encoded[0])
            policy_action = call(actor, tensordict)
            terms["loss_actor"] = -q_value(
                critics.frozen[0], without_gradient, policy_action
            ).mean()
            if self.smoothness.is_active:
                terms["loss_actor"] += self.smoothness(actor, tensordict, policy_action)
        return TensorDict(terms, [])
