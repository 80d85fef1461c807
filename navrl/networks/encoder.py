"""Attention stream and encoder that maps network inputs to one feature vector."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, cast

import torch
from torch import Tensor, nn

from navrl import keys
from navrl.deprecation import input_key
from navrl.networks.attention import LocationAttention

Shapes = Mapping[str, Sequence[int]]


class Stream(Protocol):
    """Interface of encoder streams, which are modules."""

    in_keys: list[str]
    """Keys of the values that a call takes, in order."""
    out_features: int
    """Size of the feature."""
    has_attention: bool
    """Whether a call returns attention weights after the feature."""

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the feature and, with attention, its weights."""
        ...


class Encoder(Protocol):
    """Interface of encoders, which are modules; see :class:`StreamEncoder`."""

    in_keys: list[str]
    """Keys of the values that a call takes, in order."""
    attention_keys: list[str]
    """Keys of the attention weights that a call returns after the feature."""
    out_features: int
    """Size of the feature."""

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the feature, then all attention weights."""
        ...


class AttentionStream(nn.Module):
    """Encoder stream of the paper: split an input into items and attend over them.

    Args:
        in_key: TensorDict key of the input, e.g. the points of a scan or the descriptors.
        shapes: Feature shape (without batch) of every available key; determines layer sizes.
        num_items: Number of items (sectors or descriptors). The elements of the input are split
            evenly in order: 180 points in 30 sectors give 6 neighboring points each.
        context_key: TensorDict key of the context concatenated with every item.
        embedding: Layer sizes of the embedding network.
        score: Layer sizes of the score network.
        feature: Layer sizes of the feature network.

    Raises:
        ValueError: If a key is missing or the input cannot be split into ``num_items``.

    Example:
        >>> stream = AttentionStream("spatial", {"spatial": [180, 2], "waypoints_scaled": [5, 2]})
        >>> feature, weights = stream(torch.zeros(1, 180, 2), torch.zeros(1, 5, 2))
        >>> feature.shape, weights.shape
        (torch.Size([1, 30]), torch.Size([1, 30]))

    Reference:
        Paper Sec. IV-E1. The paper's sector formula has N_b where its text implies N/N_b rays; this
        implementation uses sectors of N/N_b rays.
    """

    has_attention = True

    def __init__(
        self,
        in_key: str,
        shapes: Shapes,
        num_items: int = 30,
        context_key: str = keys.WAYPOINTS_SCALED,
        embedding: Sequence[int] = (256, 128, 64),
        score: Sequence[int] = (60, 50, 1),
        feature: Sequence[int] = (80, 50, 30),
    ) -> None:
        super().__init__()
        in_key, context_key = (input_key(key, shapes) for key in (in_key, context_key))
        size, context_size = (feature_size(shapes, key) for key in (in_key, context_key))
        if num_items <= 0 or shapes[in_key][0] % num_items:
            raise ValueError(
                f"num_items={num_items}: must divide the {shapes[in_key][0]} elements of '{in_key}'"
            )
        self.in_keys = [in_key, context_key]
        self.num_items = num_items
        self.attention = LocationAttention(
            size // num_items, context_size, embedding, score, feature
        )
        self.out_features = self.attention.out_features

    def forward(self, value: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        """Return the feature ``[*B, out_features]`` and the weights ``[*B, num_items]``."""
        items = value.flatten(-2).unflatten(-1, (self.num_items, -1))
        return self.attention(items, context.flatten(-2))


class StreamEncoder(nn.Module):
    """Encoder that concatenates the features of several streams.

    A stream is a module with ``in_keys``, ``out_features`` and ``has_attention``; called with the
    values of its keys it returns a tuple of its feature and, with attention, its weights.

    Args:
        streams: Streams by name, in order, each a constructor with the remaining argument
            ``shapes``; ``None`` removes a stream, e.g. for an ablation.
        shapes: Feature shape (without batch) of every available key.

    Raises:
        ValueError: If no stream is left.

    Example:
        >>> from functools import partial
        >>> from navrl.networks import VectorStream
        >>> goal = partial(VectorStream, in_key="goal", hidden=[16])
        >>> encoder = StreamEncoder({"goal": goal, "spatial": None}, {"goal": [2]})
        >>> encoder(torch.zeros(4, 2))[0].shape
        torch.Size([4, 16])

    Reference:
        Paper Sec. IV-E and Fig. 3c. NO-SPATIAL and NO-TEMPORAL (Sec. V-B1) remove a stream.
    """

    def __init__(self, streams: Mapping[str, Callable[..., Stream] | None], shapes: Shapes) -> None:
        super().__init__()
        built = {name: make(shapes=shapes) for name, make in streams.items() if make is not None}
        if not built:
            raise ValueError("streams: at least one stream must be left, got none")
        self.streams = nn.ModuleDict(cast(dict[str, nn.Module], built))
        self._stream_keys = [stream.in_keys for stream in built.values()]
        self.in_keys = list(dict.fromkeys(k for s in built.values() for k in s.in_keys))
        self.attention_keys = [f"{name}_attention" for name, s in built.items() if s.has_attention]
        self.out_features = sum(stream.out_features for stream in built.values())

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the concatenated feature ``[*B, out_features]``, then all attention weights."""
        by_key = dict(zip(self.in_keys, inputs, strict=True))
        results = [
            stream(*(by_key[key] for key in in_keys))
            for stream, in_keys in zip(self.streams.values(), self._stream_keys, strict=True)
        ]
        weights = [w for result in results for w in result[1:]]
        return torch.cat([result[0] for result in results], dim=-1), *weights


def feature_size(shapes: Shapes, key: str) -> int:
    """Return the number of scalar features of a key.

    Raises:
        ValueError: If the key is not observed; the message lists the available keys.
    """
    if key not in shapes:
        raise ValueError(f"key '{key}' is not observed; available: {sorted(shapes)}")
    return math.prod(shapes[key])
