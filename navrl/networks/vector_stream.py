"""Encoder stream for low-dimensional inputs."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from navrl.deprecation import input_key
from navrl.networks.encoder import Shapes, feature_size
from navrl.networks.mlp import mlp


class VectorStream(nn.Module):
    """Encoder stream for low-dimensional inputs (waypoints, goal): a multilayer perceptron.

    Args:
        in_key: TensorDict key of the input, of any shape.
        shapes: Feature shape (without batch) of every available key; determines layer sizes.
        hidden: Layer sizes, ReLU after each.

    Raises:
        ValueError: If the key is missing.

    Example:
        >>> import torch
        >>> stream = VectorStream("goal", {"goal": [2]}, hidden=[64, 32])
        >>> stream(torch.zeros(4, 2))[0].shape
        torch.Size([4, 32])
    """

    has_attention = False

    def __init__(self, in_key: str, shapes: Shapes, hidden: Sequence[int]) -> None:
        super().__init__()
        in_key = input_key(in_key, shapes)
        self.in_keys = [in_key]
        self.num_dims = len(shapes.get(in_key, ()))
        self.mlp = mlp(feature_size(shapes, in_key), hidden, activate_last=True)
        self.out_features = hidden[-1]

    def forward(self, value: Tensor) -> tuple[Tensor]:
        """Return the feature ``[*B, out_features]``."""
        return (self.mlp(value.flatten(value.ndim - self.num_dims)),)
