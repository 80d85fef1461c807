"""A linear layer and its ReLU in one pass over memory."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import linear

_HAS_FUSED = torch.backends.mkldnn.is_available() and torch.ops.mkldnn._is_mkldnn_bf16_supported()


def linear_relu(value: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Return ``relu(value @ weight.T + bias)``.

    In bfloat16 on the CPU, autocast's or the operands' own, oneDNN writes the activated output at
    once, which for the wide and shallow layers of the attention networks takes half the time of the
    two steps. Anywhere else, in ``torch.compile`` and under transforms such as ``vmap``, it is the
    two steps; in float32 they are the faster ones.

    Args:
        value: ``[*B, in]``.
        weight: ``[out, in]``.
        bias: ``[out]``.

    Returns:
        ``[*B, out]``.
    """
    dtype = value.dtype
    if torch.is_autocast_enabled(value.device.type):
        dtype = torch.get_autocast_dtype(value.device.type)
    if not _is_fusible(value, dtype):
        return linear(value, weight, bias).relu_()
    if torch.is_grad_enabled() and (value.requires_grad or weight.requires_grad):
        return _LinearReLU.apply(value, weight, bias, dtype)
    return _fused(value.to(dtype), weight.to(dtype), bias.to(dtype))


def _is_fusible(value: Tensor, dtype: torch.dtype) -> bool:
    if dtype != torch.bfloat16 or value.device.type != "cpu" or not _HAS_FUSED:
        return False
    is_transformed = torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active()
    return not is_transformed and value.numel() > 0


def _fused(value: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    return torch.ops.mkldnn._linear_pointwise(value, weight, bias, "relu", [], "")


class _LinearReLU(torch.autograd.Function):
    @staticmethod
    def forward(ctx, value: Tensor, weight: Tensor, bias: Tensor, dtype: torch.dtype) -> Tensor:
        ctx.dtypes = value.dtype, weight.dtype, bias.dtype
        value, weight = value.to(dtype), weight.to(dtype)
        output = _fused(value, weight, bias.to(dtype))
        ctx.save_for_backward(value, weight, output)
        return output

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient: Tensor) -> tuple[Tensor | None, ...]:
        value, weight, output = ctx.saved_tensors
        gradient = torch.ops.aten.threshold_backward(gradient, output, 0)
        rows = gradient.reshape(-1, gradient.shape[-1])
        needs_value, needs_weight, needs_bias, _ = ctx.needs_input_grad
        to_value = (rows @ weight).view_as(value).to(ctx.dtypes[0]) if needs_value else None
        to_weight = to_bias = None
        if needs_weight:
            to_weight = (rows.T @ value.reshape(-1, value.shape[-1])).to(ctx.dtypes[1])
        if needs_bias:
            to_bias = rows.sum(0).to(ctx.dtypes[2])
        return to_value, to_weight, to_bias, None
