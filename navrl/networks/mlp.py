"""Multilayer perceptrons of the paper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from torch import Tensor, nn

from navrl.networks.fused_layers import Layer, can_fuse, fused_layers


class Perceptron(nn.Sequential):
    """Sequence of linear layers with optional ReLU, fused where that is faster."""

    def forward(self, input: Tensor) -> Tensor:
        """Return the output of the last layer."""
        layers = _pairs(self._modules.values()) if can_fuse(input) else None
        return fused_layers(input, layers) if layers else super().forward(input)


def _pairs(modules: Iterable[nn.Module]) -> list[Layer] | None:
    """Return linear layers and whether a ReLU follows each; None for other module types."""
    layers: list[Layer] = []
    may_activate = False
    for module in modules:
        if isinstance(module, nn.Linear) and module.bias is not None:
            layers.append((module.weight, module.bias, False))
        elif isinstance(module, nn.ReLU) and may_activate:
            layers[-1] = (*layers[-1][:2], True)
        else:
            return None
        may_activate = isinstance(module, nn.Linear)
    return layers


def mlp(in_features: int, sizes: Sequence[int], *, activate_last: bool = False) -> Perceptron:
    """Build a ReLU perceptron with Xavier-uniform weights and zero biases.

    Args:
        in_features: Size of the input.
        sizes: Output size of each layer.
        activate_last: Whether to add a ReLU after the last layer.

    Returns:
        The layers in order.

    Raises:
        ValueError: If ``sizes`` is empty or a size is not positive.

    Example:
        >>> mlp(10, [128, 64, 2])
        Perceptron(
          (0): Linear(in_features=10, out_features=128, bias=True)
          (1): ReLU(inplace=True)
          (2): Linear(in_features=128, out_features=64, bias=True)
          (3): ReLU(inplace=True)
          (4): Linear(in_features=64, out_features=2, bias=True)
        )

    Reference:
        Paper Sec. IV-E (ReLU perceptrons); the initialization follows the authors' precursor.
    """
    if not sizes or any(size <= 0 for size in (in_features, *sizes)):
        raise ValueError(
            f"in_features={in_features}, sizes={list(sizes)}: must be positive and at least one"
        )
    layers: list[nn.Module] = []
    for size in sizes:
        layer = nn.Linear(in_features, size)
        nn.init.xavier_uniform_(layer.weight)
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.ReLU(inplace=True)]
        in_features = size
    return Perceptron(*(layers if activate_last else layers[:-1]))
