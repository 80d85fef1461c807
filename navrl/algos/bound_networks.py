"""Networks of a loss with weights bound to them once, and the two critics of TD3 and SAC."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from typing import TypeVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictParams
from torch import Tensor

from navrl.keys import ACTION

Network = TypeVar("Network", bound=TensorDictModuleBase)


class TwinCritics:
    """Both critics of a loss of TorchRL, their copy without gradient, and their targets.

    Args:
        network: Critic of a loss of TorchRL.
        online: Its weights ``[2]``.
        target: Its target weights ``[2]``.

    Attributes:
        online: Two networks whose gradients reach the weights.
        frozen: The same two without gradients of the weights.
        targets: Two networks with the target weights.
    """

    def __init__(
        self,
        network: TensorDictModule,
        online: TensorDictParams,
        target: TensorDictParams | TensorDictBase,
    ) -> None:
        """Bind the networks."""
        frozen = online.detach()
        self.online, self.frozen, self.targets = (
            tuple(bind(network, params[index]) for index in range(2))
            for params in (frozen, frozen, target)
        )
        slots = zip(*(_slots(critic, online) for critic in self.online), strict=True)
        self._slots = [(first[:2], second[:2], first[2]) for first, second in slots]

    def renew(self) -> None:
        """Take new views of the weights, through which gradients reach the stacked tensor.

        Not under ``torch.no_grad``, where views have no gradient.
        """
        for *slots, weights in self._slots:
            for (store, name), weight in zip(slots, weights.unbind(0), strict=True):
                store[name] = weight

    def encode(self, tensordict: TensorDictBase) -> list[tuple[Tensor, ...]]:
        """Return the encoded observations of both online critics."""
        return [encode(critic, tensordict) for critic in self.online]

    def values(self, encoded: Sequence[Sequence[Tensor]], action: Tensor) -> Tensor:
        """Return Q ``[2, B]`` of both online critics."""
        pairs = zip(self.online, encoded, strict=True)
        return torch.stack([q_value(critic, parts, action).squeeze(-1) for critic, parts in pairs])

    def least_target(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return the lower Q ``[B, 1]`` of both target critics."""
        return torch.minimum(*(q_value(c, encode(c, tensordict), action) for c in self.targets))


def bind(network: Network, params: TensorDictParams | TensorDictBase) -> Network:
    """Return a copy of a network that shares the given weights permanently."""
    # Tensors are not copied, because they are placeholders that are replaced by the weights.
    tensors = [*network.parameters(), *network.buffers()]
    network = deepcopy(network, {id(tensor): tensor for tensor in tensors})
    params.to_module(network)
    return network


def call(network: TensorDictModule, tensordict: TensorDictBase) -> Tensor:
    """Return what a network of one module computes from its keys."""
    return network.module(*(tensordict.get(key) for key in network.in_keys))


def encode(critic: TensorDictModule, tensordict: TensorDictBase) -> tuple[Tensor, ...]:
    """Return the part of a critic's input that does not depend on the action."""
    inputs = [tensordict.get(key) for key in critic.in_keys if key != ACTION]
    network = critic.module
    return (network.encode(*inputs),) if hasattr(network, "encode") else tuple(inputs)


def q_value(critic: TensorDictModule, encoded: Sequence[Tensor], action: Tensor) -> Tensor:
    """Return Q ``[B, 1]`` of an encoded observation and an action."""
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
