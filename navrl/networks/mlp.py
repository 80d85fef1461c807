"""Multilayer perceptrons as the paper uses them."""

from __future__ import annotations

from collections.abc import Sequence

from torch import nn


def mlp(in_features: int, sizes: Sequence[int], *, activate_last: bool = False) -> nn.Sequential:
    """Build a ReLU perceptron with Xavier-uniform weights and zero biases.

    Args:
        in_features: Size of the input.
        sizes: Output size of each layer.
        activate_last: Whether a ReLU follows the last layer too.

    Returns:
        The layers in order.

    Raises:
        ValueError: If ``sizes`` is empty or a size is not positive.

    Reference:
        Paper Sec. IV-E (ReLU perceptrons); the initialisation follows the authors' precursor.
    """
    if not sizes or any(size <= 0 for size in (in_features, *sizes)):
        raise ValueError(f"in_features={in_features}, sizes={list(sizes)}: need positive sizes")
    layers: list[nn.Module] = []
    for size in sizes:
        layer = nn.Linear(in_features, size)
        nn.init.xavier_uniform_(layer.weight)
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.ReLU(inplace=True)]
        in_features = size
    return nn.Sequential(*(layers if activate_last else layers[:-1]))
