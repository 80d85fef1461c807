"""Convolutional encoder streams for lidar scans."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from navrl import keys
from navrl.deprecation import input_key
from navrl.networks.attention import LocationAttention
from navrl.networks.encoder import Shapes, feature_size
from navrl.networks.mlp import mlp


class ConvStream(nn.Module):
    """Encoder stream that convolves scans along their beams, one channel per scan.

    The input is one distance per beam; the bearing of a beam is only given by its index.

    Args:
        in_keys: TensorDict keys of scans ``[*B, N]`` or of stacked scans ``[*B, C, N]``; their
            order is the order of the channels.
        shapes: Feature shape (without batch) of every available key; determines layer sizes.
        channels: Output channels of each layer, ReLU after each.
        kernel_sizes: Kernel size of each layer, in beams.
        strides: Stride of each layer, in beams.
        paddings: Padding of each layer at both ends, in beams.
        hidden: Layer sizes of the perceptron that follows, ReLU after each.
        padding_mode: ``"zeros"``, as in the baselines, or ``"circular"``, which pads with beams of
            the opposite end, because the scan covers a full circle.

    Raises:
        ValueError: If the scans or the layer lists differ in length, a layer has no output, or
            ``padding_mode`` is unknown.

    Example:
        >>> stream = ConvStream(["scan"], {"scan": [180]}, channels=[32, 32],
        ...                     kernel_sizes=[5, 3], strides=[2, 2], paddings=[1, 1], hidden=[64])
        >>> stream(torch.zeros(4, 180))[0].shape
        torch.Size([4, 64])

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
        padding_mode: str = "zeros",
    ) -> None:
        super().__init__()
        self.in_keys = [input_key(key, shapes) for key in in_keys]
        self._num_scans, num_beams = _scans(shapes, self.in_keys)
        layers = {"kernel_sizes": kernel_sizes, "strides": strides, "paddings": paddings}
        self.convolutions, self.num_places = _convolutions(
            sum(max(1, n) for n in self._num_scans), num_beams, channels, layers, padding_mode
        )
        self.num_channels = channels[-1]
        self.mlp = mlp(self.num_channels * self.num_places, hidden, activate_last=True)
        self.out_features = hidden[-1]

    def forward(self, *scans: Tensor) -> tuple[Tensor, ...]:
        """Return the feature ``[*B, out_features]`` of the scans."""
        return (self.mlp(self.convolve(*scans).flatten(-2)),)

    def convolve(self, *scans: Tensor) -> Tensor:
        """Return the feature map of the scans, ``[*B, channels, places]``."""
        channels = [
            scan if num_scans else scan.unsqueeze(-2)
            for scan, num_scans in zip(scans, self._num_scans, strict=True)
        ]
        stacked = torch.cat(channels, dim=-2)
        places = self.convolutions(stacked.reshape(-1, *stacked.shape[-2:]))
        return places.reshape(*stacked.shape[:-2], *places.shape[-2:])


class ConvAttentionStream(ConvStream):
    """Encoder stream with convolutions along the beams and attention over their outputs.

    A place (output position of the convolutions) covers neighboring beams and, with aligned past
    scans as channels, the motion in them; the attention weights the places by their relevance to
    the waypoints. The weighted sum does not retain positions, so the bearing of each place is part
    of its features, and the perceptron of :class:`ConvStream` reads the places in order.

    Args:
        in_keys: As in :class:`ConvStream`.
        shapes: As in :class:`ConvStream`.
        context_key: TensorDict key of the context concatenated with every place.
        embedding: Layer sizes of the embedding network of the attention.
        score: Layer sizes of the score network of the attention.
        feature: Layer sizes of the feature network of the attention.
        **options: Other arguments of :class:`ConvStream`.

    Raises:
        ValueError: If an argument is invalid for :class:`ConvStream` or ``context_key`` is missing.

    Example:
        >>> shapes = {"scans": [4, 180], "waypoints_scaled": [5, 2]}
        >>> stream = ConvAttentionStream(["scans"], shapes, channels=[32], kernel_sizes=[6],
        ...                              strides=[6], paddings=[0], hidden=[64])
        >>> feature, weights = stream(torch.zeros(1, 4, 180), torch.zeros(1, 5, 2))
        >>> feature.shape, weights.shape
        (torch.Size([1, 128]), torch.Size([1, 30]))

    Reference:
        Not in the paper, whose attention reads the sectors of a single scan (Sec. IV-E).
    """

    has_attention = True
    bearings: Tensor

    def __init__(
        self,
        in_keys: Sequence[str],
        shapes: Shapes,
        context_key: str = keys.WAYPOINTS_SCALED,
        embedding: Sequence[int] = (64, 64),
        score: Sequence[int] = (32, 1),
        feature: Sequence[int] = (64,),
        **options: Any,
    ) -> None:
        super().__init__(in_keys, shapes, **options)
        context_key = input_key(context_key, shapes)
        self.attention = LocationAttention(
            self.num_channels + 2, feature_size(shapes, context_key), embedding, score, feature
        )
        self.in_keys.append(context_key)
        self._num_context_dims = len(shapes[context_key])
        self.out_features += self.attention.out_features
        bearing = (torch.arange(self.num_places) + 0.5) * (2.0 * math.pi / self.num_places)
        bearings = torch.stack([bearing.cos(), bearing.sin()], dim=-1)
        self.register_buffer("bearings", bearings, persistent=False)

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return the feature ``[*B, out_features]`` and the weights ``[*B, places]``."""
        *scans, context = inputs
        places = self.convolve(*scans)
        in_order = self.mlp(places.flatten(-2))
        bearings = self.bearings.to(places.dtype).expand(*places.shape[:-2], -1, -1)
        items = torch.cat([places.transpose(-1, -2), bearings], dim=-1)
        context = context.flatten(context.ndim - self._num_context_dims)
        attended, weights = self.attention(items, context)
        return torch.cat([in_order, attended], dim=-1), weights


def _scans(shapes: Shapes, in_keys: Sequence[str]) -> tuple[list[int], int]:
    """Return the number of scans of each key (0 for an unstacked scan) and their common length."""
    found = {key: list(shapes[key]) for key in in_keys if feature_size(shapes, key)}
    lengths = {shape[-1] for shape in found.values()}
    if len(lengths) != 1 or any(len(shape) not in (1, 2) for shape in found.values()):
        raise ValueError(
            f"in_keys: must be one or more scans [N] or [C, N] of equal length, got {found}"
        )
    return [shape[0] if len(shape) == 2 else 0 for shape in found.values()], lengths.pop()


def _convolutions(
    in_channels: int,
    num_beams: int,
    channels: Sequence[int],
    layers: Mapping[str, Sequence[int]],
    padding_mode: str,
) -> tuple[nn.Sequential, int]:
    """Return the convolutions and the number of their outputs for ``num_beams``."""
    if padding_mode not in ("zeros", "circular"):
        raise ValueError(f"padding_mode={padding_mode!r}: must be zeros or circular")
    for name, values in layers.items():
        if len(values) != len(channels):
            raise ValueError(
                f"{name}={list(values)}: must have {len(channels)} values, one for each of channels"
            )
    modules: list[nn.Module] = []
    for index, (out_channels, *layer) in enumerate(zip(channels, *layers.values(), strict=True)):
        kernel_size, stride, padding = layer
        num_beams = _num_outputs(num_beams, kernel_size, stride, padding, index)
        conv = nn.Conv1d(
            in_channels, out_channels, kernel_size, stride, padding, padding_mode=padding_mode
        )
        nn.init.xavier_uniform_(conv.weight)
        assert conv.bias is not None
        nn.init.zeros_(conv.bias)
        modules += [conv, nn.ReLU(inplace=True)]
        in_channels = out_channels
    return nn.Sequential(*modules), num_beams


def _num_outputs(num_beams: int, kernel_size: int, stride: int, padding: int, layer: int) -> int:
    """Return the output length of a layer for ``num_beams`` inputs per channel."""
    if min(kernel_size, stride) < 1 or padding < 0:
        raise ValueError(
            f"layer {layer}: kernel_sizes={kernel_size}, strides={stride}: must be >= 1; "
            f"paddings={padding}: must be >= 0"
        )
    padded = num_beams + 2 * padding
    if padded < kernel_size:
        raise ValueError(
            f"layer {layer}: kernel_sizes={kernel_size}: must be at most its {padded} inputs"
        )
    return (padded - kernel_size) // stride + 1
