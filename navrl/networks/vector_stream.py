"""The stream of what is no scan."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from navrl.networks.encoder import Shapes, feature_size
from navrl.networks.mlp import mlp


class VectorStream(nn.Module):
    """Pass what is no scan (waypoints, a goal) through a perceptron.

    Args:
        in_key: TensorDict key of the input, of any shape.
        shapes: Feature shape (without batch) of every available key; sizes the stream.
        hidden: Layer sizes, ReLU after each.

    Raises:
        ValueError: If the key is missing.
    """

    has_attention = False

    def __init__(self, in_key: str, shapes: Shapes, hidden: Sequence[int]) -> None:
        super().__init__()
        self.in_keys = [in_key]
        self.num_dims = len(shapes.get(in_key, ()))
        self.mlp = mlp(feature_size(shapes, in_key), hidden, activate_last=True)
        self.out_features = hidden[-1]

    def forward(self, value: Tensor) -> tuple[Tensor]:
        """Return the feature ``[*B, out_features]``."""
        return (self.mlp(value.flatten(value.ndim - self.num_dims)),)
