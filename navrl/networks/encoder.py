"""From the network inputs of a step to one feature vector."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

from navrl import keys
from navrl.networks.attention import LocationAttention

Shapes = Mapping[str, Sequence[int]]


class AttentionStream(nn.Module):
    """One stream of the paper: split an input into items and attend over them.

    Args:
        in_key: TensorDict key of the input, e.g. the scan's points or the descriptors.
        shapes: Feature shape (without batch) of every available key; sizes the stream.
        num_items: Items along the attention axis: sectors or descriptors. The input's elements are
            split evenly and in order, so 180 points in 30 sectors give 6 neighbouring points each.
        context_key: TensorDict key of what is joined to every item.
        embedding: Layer sizes of the embedding network.
        score: Layer sizes of the score network.
        feature: Layer sizes of the feature network.

    Raises:
        ValueError: If a key is missing or the input cannot be split into ``num_items``.

    Reference:
        Paper Sec. IV-E1. The paper's sector formula repeats N_b where the text needs N/N_b rays;
        sectors here have N/N_b rays.
    """

    has_attention = True

    def __init__(
        self,
        in_key: str,
        shapes: Shapes,
        num_items: int = 30,
        context_key: str = keys.WAYPOINT_INPUT,
        embedding: Sequence[int] = (256, 128, 64),
        score: Sequence[int] = (60, 50, 1),
        feature: Sequence[int] = (80, 50, 30),
    ) -> None:
        super().__init__()
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
    """Join the features of several streams.

    A stream is a module with ``in_keys``, ``out_features`` and ``has_attention``; called with the
    values of its keys it returns a tuple of its feature and, if it attends, its weights.

    Args:
        streams: A stream per name, in order; ``None`` removes one (an ablation in one line).
            Each is a constructor that still takes ``shapes``.
        shapes: Feature shape (without batch) of every available key.

    Raises:
        ValueError: If no stream is left.

    Reference:
        Paper Sec. IV-E and Fig. 3c. NO-SPATIAL and NO-TEMPORAL (Sec. V-B1) remove a stream.
    """

    def __init__(self, streams: Mapping[str, object | None], shapes: Shapes) -> None:
        super().__init__()
        built = {name: make(shapes=shapes) for name, make in streams.items() if make is not None}
        if not built:
            raise ValueError("streams: at least one stream must be left, got none")
        self.streams = nn.ModuleDict(built)
        self.in_keys = list(dict.fromkeys(k for s in built.values() for k in s.in_keys))
        self.attention_keys = [f"{name}_attention" for name, s in built.items() if s.has_attention]
        self.out_features = sum(stream.out_features for stream in built.values())

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the joined feature ``[*B, out_features]``, then weights of those that attend."""
        by_key = dict(zip(self.in_keys, inputs, strict=True))
        results = [s(*(by_key[key] for key in s.in_keys)) for s in self.streams.values()]
        weights = [w for result in results for w in result[1:]]
        return torch.cat([result[0] for result in results], dim=-1), *weights


def feature_size(shapes: Shapes, key: str) -> int:
    """Return how many numbers a key holds.

    Raises:
        ValueError: If it is not observed, listing what is.
    """
    if key not in shapes:
        raise ValueError(f"key '{key}' is not observed; available: {sorted(shapes)}")
    return math.prod(shapes[key])
