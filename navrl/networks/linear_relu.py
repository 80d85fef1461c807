"""A linear layer and its ReLU in one pass over memory."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import linear

_FUSED = torch.ops.mkldnn._linear_pointwise if torch.backends.mkldnn.is_available() else None
_HAS_BFLOAT16 = _FUSED is not None and torch.ops.mkldnn._is_mkldnn_bf16_supported()


def linear_relu(value: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """Return ``relu(value @ weight.T + bias)``.

    On the CPU oneDNN writes the activated output at once, which for the wide and shallow layers of
    the attention networks costs a third of the two steps; autocast is respected. Anywhere else, in
    ``torch.compile`` and under transforms such as ``vmap``, it is the two steps.

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
    return _FUSED(value.to(dtype), weight.to(dtype), bias.to(dtype), "relu", [], "")


def _is_fusible(value: Tensor, dtype: torch.dtype) -> bool:
    if _FUSED is None or value.device.type != "cpu" or torch.compiler.is_compiling():
        return False
    if value.numel() == 0 or torch._C._are_functorch_transforms_active():
        return False
    return dtype == torch.float32 or (dtype == torch.bfloat16 and _HAS_BFLOAT16)


class _LinearReLU(torch.autograd.Function):
    @staticmethod
    def forward(ctx, value: Tensor, weight: Tensor, bias: Tensor, dtype: torch.dtype) -> Tensor:
        ctx.dtypes = value.dtype, weight.dtype, bias.dtype
        value, weight = value.to(dtype), weight.to(dtype)
        output = _FUSED(value, weight, bias.to(dtype), "relu", [], "")
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
