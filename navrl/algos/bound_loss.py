"""TorchRL's DDPG loss without swapping weights in and out of its networks."""

from __future__ import annotations

from copy import deepcopy

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictParams
from torch import Tensor
from torchrl.objectives import DDPGLoss
from torchrl.objectives.utils import distance_loss

from navrl.keys import ACTION


class BoundDDPGLoss(DDPGLoss):
    """What :class:`torchrl.objectives.DDPGLoss` computes, in less time.

    TorchRL's loss puts each set of weights (online, detached, target) into a network when it is
    called and takes it out again, which for the networks here is a tenth of an update. Weights only
    ever change in place, so a copy of the network for each set, bound to it once, does the same.

    A critic with ``encode`` and ``judge`` (:class:`navrl.networks.CriticNetwork`) encodes an
    observation once for both losses: the actor's loss needs no gradient of what the encoder made.

    Args:
        actor: Module writing ``action``.
        critic: Module writing ``state_action_value``; both hold one network and call it with the
            values of their ``in_keys``.
        loss_function: As TorchRL's.
    """

    def __init__(self, actor: TensorDictModule, critic: TensorDictModule, loss_function: str):
        super().__init__(
            actor, critic, loss_function=loss_function, delay_actor=True, delay_value=True
        )
        self._bound: tuple[TensorDictModule, ...] = ()

    def _bind(self) -> tuple[TensorDictModule, ...]:
        """Return the networks: actor, its target, critic, the critic without gradient, its target.

        At the first call, since TorchRL warns of targets that are asked for before anything that
        moves them exists; and in a tuple, since a module that is an attribute would have its
        weights in the ``state_dict`` twice.
        """
        if not self._bound:
            self._bound = (
                _bind(self.actor_network, self.actor_network_params),
                _bind(self.actor_network, self.target_actor_network_params),
                _bind(self.value_network, self.value_network_params),
                _bind(self.value_network, self.value_network_params.detach()),
                _bind(self.value_network, self.target_value_network_params),
            )
        return self._bound

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the losses and what they come from; ``td_error`` is written into the batch.

        Args:
            tensordict: ``[B]`` transitions.

        Returns:
            Scalars ``loss_actor`` and ``loss_value``; ``pred_value``, ``target_value`` and
            ``td_error`` ``[B]``.
        """
        actor, target_actor, critic, frozen_critic, target_critic = self._bind()
        with torch.no_grad():
            following = tensordict.get("next")
            action = _call(target_actor, following)
            next_value = _judge(target_critic, _encode(target_critic, following), action)
            target_value = self.value_estimator.value_estimate(tensordict, next_value=next_value)
        target_value = target_value.squeeze(-1)
        encoded = _encode(critic, tensordict)
        value = _judge(critic, encoded, tensordict.get(ACTION)).squeeze(-1)
        loss_value = distance_loss(value, target_value, loss_function=self.loss_function)
        without_gradient = tuple(part.detach() for part in encoded)
        policy_value = _judge(frozen_critic, without_gradient, _call(actor, tensordict))
        td_error = (value - target_value).detach().square()
        tensordict.set(self.tensor_keys.priority, td_error)
        return TensorDict(
            {
                "loss_actor": -policy_value.mean(),
                "loss_value": loss_value.mean(),
                "pred_value": value,
                "target_value": target_value,
                "td_error": td_error,
            },
            [],
        )


def _bind(network: TensorDictModule, params: TensorDictParams | TensorDictBase) -> TensorDictModule:
    """Return a copy of a network that holds these very weights, for good."""
    network = deepcopy(network)
    params.to_module(network)
    return network


def _call(network: TensorDictModule, tensordict: TensorDictBase) -> Tensor:
    return network.module(*(tensordict.get(key) for key in network.in_keys))


def _encode(critic: TensorDictModule, tensordict: TensorDictBase) -> tuple[Tensor, ...]:
    """Return what a critic makes of an observation before it sees an action."""
    inputs = [tensordict.get(key) for key in critic.in_keys if key != ACTION]
    network = critic.module
    return (network.encode(*inputs),) if hasattr(network, "encode") else tuple(inputs)


def _judge(critic: TensorDictModule, encoded: tuple[Tensor, ...], action: Tensor) -> Tensor:
    network = critic.module
    if hasattr(network, "judge"):
        return network.judge(action, *encoded)
    index = critic.in_keys.index(ACTION)
    return network(*encoded[:index], action, *encoded[index:])
