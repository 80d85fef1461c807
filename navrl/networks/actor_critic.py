"""Actor and critic networks, each with its own encoder and output module."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import torch
from tensordict import TensorDictBase, is_tensor_collection
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from navrl import keys
from navrl.deprecation import former_input, warn
from navrl.networks.encoder import Encoder, Shapes
from navrl.networks.mlp import mlp
from navrl.networks.saturation import penalize_saturation

MakeEncoder = Callable[..., Encoder]


class ActorNetwork(nn.Module):
    """Map an observation to an action in [-1, 1].

    Args:
        encoder: Built encoder; see :class:`navrl.networks.StreamEncoder`.
        action_size: Number of action dimensions.
        hidden: Hidden layer sizes of the output module.
        with_attention: Whether to return the attention weights after the action.
        saturation_penalty: Weight of the tanh saturation penalty in training; see
            :func:`navrl.networks.saturation.penalize_saturation`.

    Raises:
        ValueError: If ``saturation_penalty`` is negative.

    Reference:
        Paper Sec. IV-E, output module 128x64x64x2; tanh as in the authors' precursor. The penalty
        is an addition, 0 by default.
    """

    def __init__(
        self,
        encoder: Encoder,
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
        """Return the action ``[*B, action_size]`` and, if requested, the attention weights."""
        feature, *weights = self.encoder(*inputs)
        action = in_float32(self.output, feature)
        action = torch.tanh(penalize_saturation(action, self.saturation_penalty))
        return (action, *weights) if self.with_attention else action


class CriticNetwork(nn.Module):
    """Map an observation and an action to the Q-value.

    Args:
        encoder: Built encoder, which shares no weights with that of the actor.
        action_size: Number of action dimensions.
        hidden: Hidden layer sizes of the output module.
        observation_hidden: Sizes of layers applied to the encoder's features before they are
            concatenated with the action, ReLU after each; none by default.
        action_hidden: Sizes of layers applied to the action before the concatenation, likewise.

    Reference:
        Paper Sec. IV-E, output module 128x64x64x1. The paper does not specify where the action
        enters; it is concatenated with the features after attention, as in the authors' precursor.
        Layers before the concatenation follow Perez-D'Arpino et al. (2021).
    """

    def __init__(
        self,
        encoder: Encoder,
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
        """Return the Q-value ``[*B, 1]`` of ``action`` in ``[-1, 1]``."""
        return self.q_value(action, self.encode(*inputs))

    def encode(self, *inputs: Tensor) -> Tensor:
        """Return the feature ``[*B, n]`` of the observation, independent of the action."""
        return in_float32(self.observation, self.encoder(*inputs)[0])

    def q_value(self, action: Tensor, feature: Tensor) -> Tensor:
        """Return the Q-value ``[*B, 1]`` of ``action`` given the ``feature`` of :meth:`encode`."""
        action = in_float32(self.action, action)
        return in_float32(self.output, torch.cat([feature, action], dim=-1))

    def judge(self, action: Tensor, feature: Tensor) -> Tensor:
        """Deprecated name of :meth:`q_value`."""
        warn("CriticNetwork.judge", "use q_value")
        return self.q_value(action, feature)


class NetworkModule(TensorDictModule):
    """TensorDict module of an actor or a critic; a missing key is named with its former name."""

    def forward(  # pyright: ignore[reportIncompatibleVariableOverride]
        self, *args: Any, **kwargs: Any
    ) -> TensorDictBase | Tensor | tuple[Tensor, ...]:
        """Call the network on a TensorDict, or on the values of its keys.

        Raises:
            KeyError: If an input is missing and its former name is present.
        """
        try:
            return super().forward(*args, **kwargs)
        except Exception as error:  # tensordict passes None for a missing key
            given = cast(Any, args[0] if args else kwargs.get("tensordict"))
            names = given.keys() if is_tensor_collection(given) else ()
            hint = former_input(cast(list[str], self.in_keys), names)
            if hint is None:
                raise
            raise KeyError(hint) from error


def _layers(in_features: int, sizes: Sequence[int]) -> tuple[nn.Module, int]:
    """Return a perceptron with a final ReLU, or the identity, and its output size."""
    if not sizes:
        return nn.Identity(), in_features
    return mlp(in_features, sizes, activate_last=True), sizes[-1]


def in_float32(module: nn.Module, value: Tensor) -> Tensor:
    """Run a module in float32 even under autocast; for small layers sensitive to rounding."""
    with torch.autocast(value.device.type, enabled=False):
        return module(value.float())


def make_actor(
    encoder: MakeEncoder,
    shapes: Shapes,
    action_size: int = 2,
    hidden: Sequence[int] = (128, 64, 64),
    with_attention: bool = False,
    saturation_penalty: float = 0.0,
) -> TensorDictModule:
    """Build the actor as a TensorDict module.

    Args:
        encoder: Constructor of an encoder with the remaining argument ``shapes``.
        shapes: Feature shape (without batch) of every observed key, e.g. from the env's specs.
        action_size: Number of action dimensions.
        hidden: Hidden layer sizes of the output module.
        with_attention: Whether to write ``<stream>_attention`` keys in addition to the action.
        saturation_penalty: See :class:`ActorNetwork`.

    Returns:
        A module that reads the encoder's keys and writes ``action`` in [-1, 1].

    Raises:
        ValueError: If the encoder needs a key that ``shapes`` lacks.

    Example:
        >>> from functools import partial
        >>> from navrl.networks import StreamEncoder, VectorStream
        >>> goal = partial(VectorStream, in_key="goal", hidden=[16])
        >>> actor = make_actor(partial(StreamEncoder, streams={"goal": goal}), {"goal": [2]})
        >>> actor(goal=torch.zeros(5, 2)).shape
        torch.Size([5, 2])
    """
    network = ActorNetwork(
        encoder(shapes=shapes), action_size, hidden, with_attention, saturation_penalty
    )
    attention_keys = network.encoder.attention_keys if with_attention else []
    return NetworkModule(
        network, in_keys=[*network.encoder.in_keys], out_keys=[keys.ACTION, *attention_keys]
    )


def make_critic(
    encoder: MakeEncoder,
    shapes: Shapes,
    action_size: int = 2,
    hidden: Sequence[int] = (128, 64, 64),
    observation_hidden: Sequence[int] = (),
    action_hidden: Sequence[int] = (),
) -> TensorDictModule:
    """Build the critic as a TensorDict module; arguments as in :func:`make_actor`.

    ``observation_hidden`` and ``action_hidden`` are those of :class:`CriticNetwork`.

    Returns:
        A module that reads ``action`` and the encoder's keys and writes ``state_action_value``.

    Raises:
        ValueError: If the encoder needs a key that ``shapes`` lacks.

    Example:
        >>> from functools import partial
        >>> from navrl.networks import StreamEncoder, VectorStream
        >>> goal = partial(VectorStream, in_key="goal", hidden=[16])
        >>> critic = make_critic(partial(StreamEncoder, streams={"goal": goal}), {"goal": [2]})
        >>> critic(action=torch.zeros(5, 2), goal=torch.zeros(5, 2)).shape
        torch.Size([5, 1])
    """
    network = CriticNetwork(
        encoder(shapes=shapes), action_size, hidden, observation_hidden, action_hidden
    )
    return NetworkModule(
        network,
        in_keys=[keys.ACTION, *network.encoder.in_keys],
        out_keys=[keys.STATE_ACTION_VALUE],
    )
