"""Fused linear and ReLU layers in bfloat16: one autograd node, one memory pass per layer."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

_HAS_FUSED = torch.backends.mkldnn.is_available() and torch.ops.mkldnn._is_mkldnn_bf16_supported()

Layer = tuple[Tensor, Tensor, bool]
"""Weight ``[out, in]``, bias ``[out]``, and whether a ReLU follows."""


def can_fuse(value: Tensor) -> bool:
    """Return whether :func:`fused_layers` is faster for ``value`` than separate layers.

    This holds for bfloat16 on the CPU, from autocast or the input's dtype: oneDNN writes the
    activated output directly, which halves the time for the wide and shallow layers of the
    attention networks. It is not supported in ``torch.compile`` and under transforms such as
    ``vmap``; in float32 separate layers are faster.
    """
    device = value.device.type
    dtype = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else value.dtype
    if dtype != torch.bfloat16 or device != "cpu" or not _HAS_FUSED:
        return False
    is_transformed = torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active()
    return not is_transformed and value.numel() > 0


def fused_layers(value: Tensor, layers: Sequence[Layer]) -> Tensor:
    """Apply layers to a value in bfloat16.

    Args:
        value: ``[*B, in]``, for which :func:`can_fuse` holds.
        layers: Weights, biases and activations in order, at least one.

    Returns:
        ``[*B, out]`` of the last layer. Gradients have the dtypes of their tensors.
    """
    weights = [weight for layer in layers for weight in layer[:2]]
    activated = [layer[2] for layer in layers]
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in (value, *weights)):
        return _FusedLayers.apply(value, activated, *weights)
    value = value.to(torch.bfloat16)
    for weight, bias, activate in layers:
        value = _layer(value, weight.to(torch.bfloat16), bias.to(torch.bfloat16), activate)
    return value


def _layer(value: Tensor, weight: Tensor, bias: Tensor, activate: bool) -> Tensor:
    activation = "relu" if activate else "none"
    return torch.ops.mkldnn._linear_pointwise(value, weight, bias, activation, [], "")


class _FusedLayers(torch.autograd.Function):
    @staticmethod
    def forward(ctx, value: Tensor, activated: list[bool], *weights: Tensor) -> Tensor:
        ctx.activated = activated
        ctx.dtypes = value.dtype, *(weight.dtype for weight in weights)
        values = [value.to(torch.bfloat16)]
        matrices = []
        for index, activate in enumerate(activated):
            matrix, bias = (w.to(torch.bfloat16) for w in weights[2 * index : 2 * index + 2])
            matrices.append(matrix)
            values.append(_layer(values[-1], matrix, bias, activate))
        # The last output is only needed for the gradient of its ReLU.
        ctx.save_for_backward(*matrices, *(values if activated[-1] else values[:-1]))
        return values[-1]

    @staticmethod
    @once_differentiable
    # torch annotates what the decorator returns as a function without keywords.
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx, gradient: Tensor
    ) -> tuple[Tensor | None, ...]:
        count = len(ctx.activated)
        matrices, values = ctx.saved_tensors[:count], ctx.saved_tensors[count:]
        shape = values[0].shape
        values = [value.reshape(-1, value.shape[-1]) for value in values]
        rows = gradient.reshape(-1, gradient.shape[-1])
        needs_value, _, *needs = ctx.needs_input_grad
        first = -1 if needs_value else needs.index(True) // 2  # layers below need no gradient
        to_weights: list[Tensor | None] = [None] * len(needs)
        for index in reversed(range(count)):
            if ctx.activated[index]:
                rows = torch.ops.aten.threshold_backward(rows, values[index + 1], 0)
            if needs[2 * index]:
                to_weights[2 * index] = _outer(rows, values[index]).to(ctx.dtypes[2 * index + 1])
            if needs[2 * index + 1]:
                to_weights[2 * index + 1] = rows.sum(0).to(ctx.dtypes[2 * index + 2])
            if index == first:
                break
            rows = rows @ matrices[index]
        to_value = rows.view(shape).to(ctx.dtypes[0]) if needs_value else None
        return to_value, None, *to_weights


def _outer(rows: Tensor, values: Tensor) -> Tensor:
    """Return ``rows.T @ values``; oneDNN is faster with the narrower operand on the left."""
    if rows.shape[-1] > values.shape[-1]:
        return (values.T @ rows).T
    return rows.T @ values
