"""Streams without attention: convolutions over scans, perceptrons over everything else."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from navrl.networks.encoder import Shapes, feature_size
from navrl.networks.mlp import mlp


class ConvStream(nn.Module):
    """Convolve scans along their beams; each scan is a channel.

    Distances alone are read, one a beam: where a beam points is only in its place. The layers do
    not wrap around behind the robot, as in the baselines they are taken from.

    Args:
        in_keys: TensorDict keys of the scans ``[*B, N]``, oldest first.
        shapes: Feature shape (without batch) of every available key; sizes the stream.
        channels: Output channels of each layer, ReLU after each.
        kernel_sizes: Beams each layer looks at.
        strides: Beams each layer moves on by.
        paddings: Zeros each layer adds at both ends.
        hidden: Layer sizes of the perceptron that follows, ReLU after each.

    Raises:
        ValueError: If the scans differ in shape, the layers' lists in length, or if no beam is left
            after a layer.

    Reference:
        Paper Sec. V-C: the lidar encoders of Liang et al. (2020) and Perez-D'Arpino et al. (2021).
    """

    has_attention = False

    def __init__(
        self,
        in_keys: Sequence[str],
        shapes: Shapes,
        channels: Sequence[int],
        kernel_sizes: Sequence[int],
        strides: Sequence[int],
        paddings: Sequence[int],
        hidden: Sequence[int],
    ) -> None:
        super().__init__()
        self.in_keys = list(in_keys)
        num_beams = _common_length(shapes, self.in_keys)
        lists = {"kernel_sizes": kernel_sizes, "strides": strides, "paddings": paddings}
        for name, values in lists.items():
            if len(values) != len(channels):
                raise ValueError(
                    f"{name}={list(values)}: need {len(channels)} values, as channels has"
                )
        layers: list[nn.Module] = []
        in_channels = len(self.in_keys)
        for index, layer in enumerate(zip(channels, *lists.values(), strict=True)):
            out_channels, kernel_size, stride, padding = layer
            num_beams = _num_outputs(num_beams, kernel_size, stride, padding, index)
            conv = nn.Conv1d(in_channels, out_channels, kernel_size, stride, padding)
            nn.init.xavier_uniform_(conv.weight)
            nn.init.zeros_(conv.bias)
            layers += [conv, nn.ReLU(inplace=True)]
            in_channels = out_channels
        self.convolutions = nn.Sequential(*layers, nn.Flatten())
        self.mlp = mlp(in_channels * num_beams, hidden, activate_last=True)
        self.out_features = hidden[-1]

    def forward(self, *scans: Tensor) -> tuple[Tensor]:
        """Return the feature ``[*B, out_features]`` of scans ``[*B, N]``."""
        stacked = torch.stack(scans, dim=-2)
        batch = stacked.shape[:-2]
        feature = self.mlp(self.convolutions(stacked.reshape(-1, *stacked.shape[-2:])))
        return (feature.reshape(*batch, self.out_features),)


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


def _common_length(shapes: Shapes, in_keys: Sequence[str]) -> int:
    sizes = {key: feature_size(shapes, key) for key in in_keys}
    if len(set(sizes.values())) != 1 or any(len(shapes[key]) != 1 for key in in_keys):
        found = {key: list(shapes[key]) for key in in_keys}
        raise ValueError(f"in_keys: need one or more scans [N] of equal length, got {found}")
    return next(iter(sizes.values()))


def _num_outputs(num_beams: int, kernel_size: int, stride: int, padding: int, layer: int) -> int:
    """Return how many values a layer makes of each channel's ``num_beams``."""
    if min(kernel_size, stride) < 1 or padding < 0:
        raise ValueError(
            f"layer {layer}: kernel_sizes={kernel_size}, strides={stride}: must be >= 1; "
            f"paddings={padding}: must be >= 0"
        )
    padded = num_beams + 2 * padding
    if padded < kernel_size:
        raise ValueError(f"layer {layer}: kernel_sizes={kernel_size} exceeds its {padded} inputs")
    return (padded - kernel_size) // stride + 1
