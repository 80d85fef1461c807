"""TorchRL's DDPG and TD3 losses with weights bound to network copies once.

TorchRL's losses swap each set of weights (online, detached, target) into a network for every call,
which takes a tenth of an update for the networks of navrl, and more with two critics. Weights only
change in place, so one copy of the network per set, bound to its weights once, is equivalent.

A critic with ``encode`` and ``q_value`` (:class:`navrl.networks.CriticNetwork`) encodes an
observation once for both losses, because the actor's loss needs no gradient of the encoder.
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

from navrl.algos.action_smoothness import ActionSmoothness
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
                _bind(self.actor_network, self.actor_network_params),
                _bind(self.actor_network, self.target_actor_network_params),
                _bind(self.value_network, self.value_network_params),
                _bind(self.value_network, self.value_network_params.detach()),
                _bind(self.value_network, self.target_value_network_params),
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
            action = _call(target_actor, following)
            next_value = _q_value(target_critic, _encode(target_critic, following), action)
            target_value = self.value_estimator.value_estimate(tensordict, next_value=next_value)
        target_value = target_value.squeeze(-1)
        encoded = _encode(critic, tensordict)
        value = _q_value(critic, encoded, tensordict.get(ACTION)).squeeze(-1)
        loss_value = distance_loss(value, target_value, loss_function=self.loss_function)
        without_gradient = tuple(part.detach() for part in encoded)
        policy_action = _call(actor, tensordict)
        policy_value = _q_value(frozen_critic, without_gradient, policy_action)
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
        self._bound: tuple[TensorDictModule, ...] = ()

    def _bind(self) -> tuple[TensorDictModule, ...]:
        """Return actor, target actor, both critics, critic without gradient, target critics."""
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
        # Weights are views, so gradients of both critics reach the stacked tensor of their weights.
        for *slots, weights in self._slots:
            for (store, name), weight in zip(slots, weights.unbind(0), strict=True):
                store[name] = weight
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
        actor, target_actor, first, second, frozen, *targets = self._bind()
        action = tensordict.get(ACTION)
        noise = (torch.randn_like(action) * self.policy_noise).clamp(
            -self.noise_clip, self.noise_clip
        )
        with torch.no_grad():
            following = tensordict.get("next")
            next_action = _call(target_actor, following) + noise
            next_action = next_action.clamp(self.min_action, self.max_action)
            next_values = [_q_value(c, _encode(c, following), next_action) for c in targets]
            next_value = torch.minimum(*next_values)
            target_value = self.value_estimator.value_estimate(tensordict, next_value=next_value)
        target_value = target_value.squeeze(-1)
        encoded = [_encode(critic, tensordict) for critic in (first, second)]
        values = torch.stack(
            [
                _q_value(critic, parts, action).squeeze(-1)
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
            policy_action = _call(actor, tensordict)
            terms["loss_actor"] = -_q_value(frozen, without_gradient, policy_action).mean()
            if self.smoothness.is_active:
                terms["loss_actor"] += self.smoothness(actor, tensordict, policy_action)
        return TensorDict(terms, [])


def _bind(network: TensorDictModule, params: TensorDictParams | TensorDictBase) -> TensorDictModule:
    """Return a copy of a network that shares the given weights permanently."""
    # Tensors are not copied, because they are placeholders that are replaced by the weights.
    tensors = [*network.parameters(), *network.buffers()]
    network = deepcopy(network, {id(tensor): tensor for tensor in tensors})
    params.to_module(network)
    return network


def _call(network: TensorDictModule, tensordict: TensorDictBase) -> Tensor:
    return network.module(*(tensordict.get(key) for key in network.in_keys))


def _encode(critic: TensorDictModule, tensordict: TensorDictBase) -> tuple[Tensor, ...]:
    """Return the part of a critic's input that does not depend on the action."""
    inputs = [tensordict.get(key) for key in critic.in_keys if key != ACTION]
    network = critic.module
    return (network.encode(*inputs),) if hasattr(network, "encode") else tuple(inputs)


def _q_value(critic: TensorDictModule, encoded: tuple[Tensor, ...], action: Tensor) -> Tensor:
    network = critic.module
    if hasattr(network, "encode"):
        value = network.q_value if hasattr(network, "q_value") else network.judge  # of navrl 0.1
        return value(action, *encoded)
    index = critic.in_keys.index(ACTION)
    return network(*encoded[:index], action, *encoded[index:])


def _slots(
    network: TensorDictModule, params: TensorDictParams
) -> Iterator[tuple[dict[str, Tensor], str, Tensor]]:
    """Yield container, name and stacked tensor of each weight and buffer of a network."""
    for path, module in network.named_modules():
        for store in (module._parameters, module._buffers):
            for name in list(store):
                yield store, name, params.get((*path.split("."), name))
