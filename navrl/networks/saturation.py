"""Tanh saturation penalty, added to the gradients in the backward pass."""

from __future__ import annotations

import torch
from torch import Tensor


class _SaturationPenalty(torch.autograd.Function):
    """Identity function with the gradient of an added loss ``weight * mean(sum(x**2, -1))``."""

    @staticmethod
    def forward(ctx, value: Tensor, weight: float) -> Tensor:
        ctx.save_for_backward(value)
        ctx.weight = weight
        return value.view_as(value)

    @staticmethod
    def backward(ctx, *gradients: Tensor) -> tuple[Tensor, None]:
        (gradient,), (value,) = gradients, ctx.saved_tensors
        num_samples = max(value.shape[:-1].numel(), 1)
        return gradient + (2.0 * ctx.weight / num_samples) * value, None


def penalize_saturation(value: Tensor, weight: float) -> Tensor:
    """Return ``value`` unchanged and add the gradient of a saturation penalty in backward.

    The policy gradient through a tanh vanishes for large inputs, so an actor that saturates on
    every observation cannot recover. The gradient of the penalty does not vanish there. As it is
    added in the backward pass, it works with any loss that averages over the batch.

    Args:
        value: ``[*B, A]`` inputs of the tanh.
        weight: Weight of the penalty on the squared norm; 0 disables it.

    Returns:
        ``value``, unchanged.

    Example:
        >>> value = torch.tensor([[3.0, -1.0]], requires_grad=True)
        >>> penalize_saturation(value, weight=0.5).sum().backward()
        >>> value.grad  # 1 + 2 * 0.5 * value
        tensor([[4., 0.]])
    """
    return _SaturationPenalty.apply(value, weight) if weight > 0.0 else value
