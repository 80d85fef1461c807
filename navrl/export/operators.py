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
_OP: Any = opset20  # its types do not allow a value under construction
_DOUBLE, _FLOAT = onnx_ir.DataType.DOUBLE, onnx_ir.DataType.FLOAT


def translations() -> dict[Callable, Callable]:
    """Return the ONNX form of each operator."""
    return {
        torch.ops.prims.hypot.default: _hypot,
        torch.ops.aten.where.self: _where,
        torch.ops.aten.atan2.default: _atan2,
    }


def _hypot(x: Value, y: Value) -> Value:
    return _OP.Sqrt(_OP.Add(_OP.Mul(x, x), _OP.Mul(y, y)))


def _where(condition: Value, x: Value, y: Value) -> Value:
    """Select from flags by logic, because ONNX Runtime's Where does not take them."""
    if x.dtype != onnx_ir.DataType.BOOL:
        return _OP.Where(condition, x, y)
    otherwise = _OP.And(_OP.Not(condition), y)
    return _OP.Or(_OP.And(condition, x), otherwise)


def _atan2(y: Value, x: Value) -> Value:
    """Return the angle of (x, y), in float64 by one Newton step from the one in float32.

    ONNX Runtime has no arc tangent in float64.
    """
    if y.dtype != _DOUBLE:
        return _single_atan2(y, x)
    angle = _OP.Cast(_single_atan2(_OP.Cast(y, to=_FLOAT), _OP.Cast(x, to=_FLOAT)), to=_DOUBLE)
    cos, sin = _OP.Cos(angle), _OP.Sin(angle)
    across = _OP.Sub(_OP.Mul(y, cos), _OP.Mul(x, sin))
    along = _OP.Add(_OP.Mul(x, cos), _OP.Mul(y, sin))
    zero = _constant(0.0, y)
    is_origin = _OP.Equal(along, zero)
    error = _OP.Div(across, _OP.Where(is_origin, _constant(1.0, y), along))
    return _OP.Add(angle, error)  # its cube is below 1e-20


def _single_atan2(y: Value, x: Value) -> Value:
    zero = _constant(0.0, None)
    angle = _OP.Atan(_OP.Div(y, _OP.Abs(x)))  # an x of -0 is not less than zero
    angle = _OP.Where(_OP.IsNaN(angle), zero, angle)
    half = _OP.Where(_OP.Less(y, zero), _constant(-math.pi, None), _constant(math.pi, None))
    return _OP.Where(_OP.Less(x, zero), _OP.Sub(half, angle), angle)


def _constant(value: float, like: Value) -> Value:
    kind = np.float64 if like is not None and like.dtype == _DOUBLE else np.float32
    return _OP.Constant(value=onnx_ir.tensor(np.array(value, kind)))
