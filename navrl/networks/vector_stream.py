"""Encoder stream for low-dimensional inputs."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from navrl.deprecation import input_key
from navrl.networks.encoder import Shapes, feature_size
from navrl.networks.mlp import mlp


class VectorStream(nn.Module):
    """Encoder stream for low-dimensional inputs (waypoints, velocity): a multilayer perceptron.

    Args:
        in_key: TensorDict key of the input, of any shape; or several keys, whose values are
            concatenated.
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

    def __init__(self, in_key: str | Sequence[str], shapes: Shapes, hidden: Sequence[int]) -> None:
        super().__init__()
        in_keys = [in_key] if isinstance(in_key, str) else in_key
        self.in_keys = [input_key(key, shapes) for key in in_keys]
        self._num_dims = [len(shapes.get(key, ())) for key in self.in_keys]
        size = sum(feature_size(shapes, key) for key in self.in_keys)
        self.mlp = mlp(size, hidden, activate_last=True)
        self.out_features = hidden[-1]

    def forward(self, *values: Tensor) -> tuple[Tensor]:
        """Return the feature ``[*B, out_features]``."""
        flat = [
            value.flatten(value.ndim - num_dims)
            for value, num_dims in zip(values, self._num_dims, strict=True)
        ]
        return (self.mlp(flat[0] if len(flat) == 1 else torch.cat(flat, dim=-1)),)
