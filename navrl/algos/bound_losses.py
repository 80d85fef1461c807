"""TorchRL's DDPG and TD3 losses without swapping weights in and out of their networks.

TorchRL's losses put each set of weights (online, detached, target) into a network when it is
called and take it out again, which for the networks here is a tenth of an update, and more for two
critics. Weights only ever change in place, so a copy of the network for each set, bound to it
once, does the same.

A critic with ``encode`` and ``judge`` (:class:`navrl.networks.CriticNetwork`) encodes an
observation once for both losses: the actor's loss needs no gradient of what the encoder made.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictParams
from torch import Tensor
from torchrl.objectives import DDPGLoss, TD3Loss
from torchrl.objectives.utils import distance_loss

from navrl.keys import ACTION


class BoundDDPGLoss(DDPGLoss):
    """What :class:`torchrl.objectives.DDPGLoss` computes, in less time.

    Args:
        actor: Module writing ``action``.
        critic: Module writing ``state_action_value``; both hold one network and call it with the
            values of their ``in_keys``.
        loss_function: As TorchRL's.
    """

    def __init__(
        self, actor: TensorDictModule, critic: TensorDictModule, loss_function: str
    ) -> None:
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


class BoundTD3Loss(TD3Loss):
    """What :class:`torchrl.objectives.TD3Loss` computes, in less time.

    Args:
        actor: As for :class:`BoundDDPGLoss`.
        critic: As for :class:`BoundDDPGLoss`; two are made of it.
        loss_function: As TorchRL's.
        target_noise: Standard deviation of the noise on target actions.
        target_noise_clip: Largest noise.
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
            deactivate_vmap=True,  # autocast does not reach into a vmap on the CPU
        )
        self._bound: tuple[TensorDictModule, ...] = ()

    def _bind(self) -> tuple[TensorDictModule, ...]:
        """Return actor, its target, both critics, the first one without gradient, both targets."""
        if not self._bound:
            online, target = self.qvalue_network_params, self.target_qvalue_network_params
            frozen = online.detach()
            self._bound = (
                _bind(self.actor_network, self.actor_network_params),
                _bind(self.actor_network, self.target_actor_network_params),
                *(_bind(self.qvalue_network, params[0]) for params in (frozen, frozen, frozen)),
                *(_bind(self.qvalue_network, target[index]) for index in range(2)),
            )
            critics = self._bound[2:4]
            slots = zip(*(_slots(critic, online) for critic in critics), strict=True)
            self._slots = [(first[:2], second[:2], first[2]) for first, second in slots]
        # Gradients of both critics reach the one tensor that holds their weights together.
        for *slots, weights in self._slots:
            for (store, name), weight in zip(slots, weights.unbind(0), strict=True):
                store[name] = weight
        return self._bound

    def forward(self, tensordict: TensorDictBase, with_actor: bool = True) -> TensorDictBase:
        """Return the losses and what they come from; ``td_error`` is written into the batch.

        Args:
            tensordict: ``[B]`` transitions.
            with_actor: Whether the actor's loss is asked for.

        Returns:
            Scalars ``loss_qvalue`` and, if asked for, ``loss_actor``; ``pred_value`` ``[2, B]`` and
            ``target_value`` ``[B]``.
        """
        actor, target_actor, first, second, frozen, *targets = self._bind()
        action = tensordict.get(ACTION)
        noise = (torch.randn_like(action) * self.policy_noise).clamp(
            -self.noise_clip, self.noise_clip
        )
        with torch.no_grad():
            following = tensordict.get("next")
            next_action = _call(target_actor, following) + noise
            next_action = next_action.clamp(self.min_action, self.max_action)
            next_values = [_judge(c, _encode(c, following), next_action) for c in targets]
            next_value = torch.minimum(*next_values)
            target_value = self.value_estimator.value_estimate(tensordict, next_value=next_value)
        target_value = target_value.squeeze(-1)
        encoded = [_encode(critic, tensordict) for critic in (first, second)]
        values = torch.stack(
            [
                _judge(critic, parts, action).squeeze(-1)
                for critic, parts in zip((first, second), encoded, strict=True)
            ]
        )
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
            policy_value = _judge(frozen, without_gradient, _call(actor, tensordict))
            terms["loss_actor"] = -policy_value.mean()
        return TensorDict(terms, [])


def _bind(network: TensorDictModule, params: TensorDictParams | TensorDictBase) -> TensorDictModule:
    """Return a copy of a network that holds these very weights, for good."""
    # All is copied but the tensors, which stand in for weights and are about to be replaced.
    tensors = [*network.parameters(), *network.buffers()]
    network = deepcopy(network, {id(tensor): tensor for tensor in tensors})
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


def _slots(
    network: TensorDictModule, params: TensorDictParams
) -> Iterator[tuple[dict[str, Tensor], str, Tensor]]:
    """Yield where a network keeps each of its weights and buffers, its name and the stack of it."""
    for path, module in network.named_modules():
        for store in (module._parameters, module._buffers):
            for name in list(store):
                yield store, name, params.get((*path.split("."), name))
