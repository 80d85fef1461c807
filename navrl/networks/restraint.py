"""A penalty on large inputs of a tanh, added where gradients pass."""

from __future__ import annotations

import torch
from torch import Tensor


class _Restraint(torch.autograd.Function):
    """The identity, whose gradient is that of an added loss ``weight * mean(sum(x**2, -1))``."""

    @staticmethod
    def forward(ctx, value: Tensor, weight: float) -> Tensor:
        ctx.save_for_backward(value)
        ctx.weight = weight
        return value.view_as(value)

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor, None]:
        (value,) = ctx.saved_tensors
        num_samples = max(value.shape[:-1].numel(), 1)
        return gradient + (2.0 * ctx.weight / num_samples) * value, None


def restrain(value: Tensor, weight: float) -> Tensor:
    """Return ``value`` and pull it towards zero in the backward pass.

    A policy gradient through tanh vanishes where its input is large: an actor that once drives at
    full speed and full turn on every observation cannot learn its way back. The pull does not
    vanish there. Acting as a gradient, it works under any loss that averages over the batch.

    Args:
        value: ``[*B, A]`` inputs of the tanh.
        weight: Of the penalty on the squared norm; 0 leaves everything as it is.

    Returns:
        ``value``, unchanged.
    """
    return _Restraint.apply(value, weight) if weight > 0.0 else value
