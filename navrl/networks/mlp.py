"""Multilayer perceptrons as the paper uses them."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from navrl.networks.linear_relu import linear_relu


class Perceptron(nn.Sequential):
    """Layers in order, a linear layer and the ReLU after it in one step."""

    def forward(self, value: Tensor) -> Tensor:
        """Return the last layer's output."""
        waiting = None
        for layer in self._modules.values():
            if waiting is not None:
                if isinstance(layer, nn.ReLU):
                    value, waiting = linear_relu(value, waiting.weight, waiting.bias), None
                    continue
                value, waiting = waiting(value), None
            if isinstance(layer, nn.Linear):
                waiting = layer
            else:
                value = layer(value)
        return value if waiting is None else waiting(value)


def mlp(in_features: int, sizes: Sequence[int], *, activate_last: bool = False) -> Perceptron:
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
    return Perceptron(*(layers if activate_last else layers[:-1]))
