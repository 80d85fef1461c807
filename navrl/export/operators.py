"""ONNX forms of operators that torch's exporter or ONNX Runtime lacks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import onnx_ir
import torch
from onnxscript import opset20

Value = Any  # of a graph under construction
_DOUBLE, _FLOAT = onnx_ir.DataType.DOUBLE, onnx_ir.DataType.FLOAT


def translations() -> dict[Callable, Callable]:
    """Return the ONNX form of each operator."""
    return {
        torch.ops.prims.hypot.default: _hypot,
        torch.ops.aten.where.self: _where,
        torch.ops.aten.atan2.default: _atan2,
    }


def _hypot(x: Value, y: Value) -> Value:
    return opset20.Sqrt(opset20.Add(opset20.Mul(x, x), opset20.Mul(y, y)))


def _where(condition: Value, x: Value, y: Value) -> Value:
    """Select from flags by logic, because ONNX Runtime's Where does not take them."""
    if x.dtype != onnx_ir.DataType.BOOL:
        return opset20.Where(condition, x, y)
    otherwise = opset20.And(opset20.Not(condition), y)
    return opset20.Or(opset20.And(condition, x), otherwise)


def _atan2(y: Value, x: Value) -> Value:
    """Return the angle of (x, y), in float64 by one Newton step from the one in float32.

    ONNX Runtime has no arc tangent in float64.
    """
    if y.dtype != _DOUBLE:
        return _single_atan2(y, x)
    op = opset20
    angle = op.Cast(_single_atan2(op.Cast(y, to=_FLOAT), op.Cast(x, to=_FLOAT)), to=_DOUBLE)
    cos, sin = op.Cos(angle), op.Sin(angle)
    across = op.Sub(op.Mul(y, cos), op.Mul(x, sin))
    along = op.Add(op.Mul(x, cos), op.Mul(y, sin))
    zero = _constant(0.0, y)
    is_origin = op.Equal(along, zero)
    error = op.Div(across, op.Where(is_origin, _constant(1.0, y), along))
    return op.Add(angle, error)  # its cube is below 1e-20


def _single_atan2(y: Value, x: Value) -> Value:
    op, zero = opset20, _constant(0.0, None)
    angle = op.Atan(op.Div(y, x))
    angle = op.Where(op.IsNaN(angle), zero, angle)
    half = op.Where(op.Less(y, zero), _constant(-math.pi, None), _constant(math.pi, None))
    return op.Where(op.Less(x, zero), op.Add(angle, half), angle)


def _constant(value: float, like: Value) -> Value:
    kind = np.float64 if like is not None and like.dtype == _DOUBLE else np.float32
    return opset20.Constant(value=onnx_ir.tensor(np.array(value, kind)))
