"""Actor and critic: an encoder of their own each, and the output module."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from navrl import keys
from navrl.networks.encoder import Shapes
from navrl.networks.mlp import mlp
from navrl.networks.restraint import restrain

Encoder = Callable[..., nn.Module]


class ActorNetwork(nn.Module):
    """Map an observation to an action in [-1, 1].

    Args:
        encoder: Built encoder; see :class:`navrl.networks.StreamEncoder`.
        action_size: Number of action dimensions.
        hidden: Hidden layer sizes of the output module.
        with_attention: Whether the attention weights are returned after the action.
        saturation_penalty: Weight of the penalty on large inputs of the tanh while learning; see
            :func:`navrl.networks.restraint.restrain`.

    Raises:
        ValueError: If ``saturation_penalty`` is negative.

    Reference:
        Paper Sec. IV-E, output module 128x64x64x2; tanh as in the authors' precursor. The penalty
        is an addition, 0 by default.
    """

    def __init__(
        self,
        encoder: nn.Module,
        action_size: int = 2,
        hidden: Sequence[int] = (128, 64, 64),
        with_attention: bool = False,
        saturation_penalty: float = 0.0,
    ) -> None:
        super().__init__()
        if not saturation_penalty >= 0.0:
            raise ValueError(f"saturation_penalty={saturation_penalty}: must be >= 0")
        self.saturation_penalty = saturation_penalty
        self.encoder = encoder
        self.output = mlp(encoder.out_features, [*hidden, action_size])
        self.with_attention = with_attention

    def forward(self, *inputs: Tensor) -> Tensor | tuple[Tensor, ...]:
        """Return the action ``[*B, action_size]``, and the weights if asked for."""
        feature, *weights = self.encoder(*inputs)
        action = in_float32(self.output, feature)
        action = torch.tanh(restrain(action, self.saturation_penalty))
        return (action, *weights) if self.with_attention else action


class CriticNetwork(nn.Module):
    """Map an observation and an action to the action's value.

    Args:
        encoder: Built encoder, sharing nothing with the actor's.
        action_size: Number of action dimensions.
        hidden: Hidden layer sizes of the output module.
        observation_hidden: Layers that the encoder's features pass before the action joins them,
            ReLU after each; none by default.
        action_hidden: Layers that the action passes before, in the same way.

    Reference:
        Paper Sec. IV-E, output module 128x64x64x1. The paper does not say where the action enters;
        it joins the features after attention, as in the authors' precursor. Layers before that are
        those of Perez-D'Arpino et al. (2021).
    """

    def __init__(
        self,
        encoder: nn.Module,
        action_size: int = 2,
        hidden: Sequence[int] = (128, 64, 64),
        observation_hidden: Sequence[int] = (),
        action_hidden: Sequence[int] = (),
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.observation, observation_size = _layers(encoder.out_features, observation_hidden)
        self.action, action_size = _layers(action_size, action_hidden)
        self.output = mlp(observation_size + action_size, [*hidden, 1])

    def forward(self, action: Tensor, *inputs: Tensor) -> Tensor:
        """Return the value ``[*B, 1]`` of ``action`` in ``[-1, 1]``."""
        return self.judge(action, self.encode(*inputs))

    def encode(self, *inputs: Tensor) -> Tensor:
        """Return the observation's feature ``[*B, n]``, which no action changes."""
        return in_float32(self.observation, self.encoder(*inputs)[0])

    def judge(self, action: Tensor, feature: Tensor) -> Tensor:
        """Return the value ``[*B, 1]`` of ``action`` where :meth:`encode` gave ``feature``."""
        action = in_float32(self.action, action)
        return in_float32(self.output, torch.cat([feature, action], dim=-1))


def _layers(in_features: int, sizes: Sequence[int]) -> tuple[nn.Module, int]:
    """Return a perceptron that ends in a ReLU, or nothing at all, and the size of what it gives."""
    if not sizes:
        return nn.Identity(), in_features
    return mlp(in_features, sizes, activate_last=True), sizes[-1]


def in_float32(module: nn.Module, value: Tensor) -> Tensor:
    """Run the last layers in float32 even under autocast: they cost little and decide much."""
    with torch.autocast(value.device.type, enabled=False):
        return module(value.float())


def make_actor(
    encoder: Encoder,
    shapes: Shapes,
    action_size: int = 2,
    hidden: Sequence[int] = (128, 64, 64),
    with_attention: bool = False,
    saturation_penalty: float = 0.0,
) -> TensorDictModule:
    """Build the actor as a TensorDict module.

    Args:
        encoder: Constructor of an encoder that still takes ``shapes``.
        shapes: Feature shape (without batch) of every observed key, e.g. from the env's specs.
        action_size: Number of action dimensions.
        hidden: Hidden layer sizes of the output module.
        with_attention: Whether ``<stream>_attention`` keys are written beside the action.
        saturation_penalty: See :class:`ActorNetwork`.

    Returns:
        A module that reads the encoder's keys and writes ``action`` in [-1, 1].

    Raises:
        ValueError: If the encoder needs a key that ``shapes`` lacks.
    """
    network = ActorNetwork(
        encoder(shapes=shapes), action_size, hidden, with_attention, saturation_penalty
    )
    out_keys = [keys.ACTION, *(network.encoder.attention_keys if with_attention else [])]
    return TensorDictModule(network, in_keys=network.encoder.in_keys, out_keys=out_keys)


def make_critic(
    encoder: Encoder,
    shapes: Shapes,
    action_size: int = 2,
    hidden: Sequence[int] = (128, 64, 64),
    observation_hidden: Sequence[int] = (),
    action_hidden: Sequence[int] = (),
) -> TensorDictModule:
    """Build the critic as a TensorDict module; arguments as in :func:`make_actor`.

    The last two are those of :class:`CriticNetwork`.

    Returns:
        A module that reads ``action`` and the encoder's keys and writes ``state_action_value``.
    """
    network = CriticNetwork(
        encoder(shapes=shapes), action_size, hidden, observation_hidden, action_hidden
    )
    return TensorDictModule(
        network,
        in_keys=[keys.ACTION, *network.encoder.in_keys],
        out_keys=[keys.STATE_ACTION_VALUE],
    )
