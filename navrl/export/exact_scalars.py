"""Numbers of a graph in float64 that remain in float64."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

_NAMES = ("add", "sub", "mul", "div", "truediv", "remainder")
_ARITHMETIC = {*_NAMES, *(f"__{name}__" for name in _NAMES), *(f"__r{name}__" for name in _NAMES)}


class ExactScalars(TorchFunctionMode):
    """While it is active, numbers in arithmetic with float64 tensors become float64 tensors.

    torch 2.13 writes the number of ``x * 0.1`` into an ONNX file in float32, also for an ``x`` in
    float64: a beam's bearing of 2 rad is then off by 1e-7 rad, which is more than the width of the
    border between two beams.
    """

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> object:
        """Call the function with tensors in place of numbers."""
        if getattr(func, "__name__", "") in _ARITHMETIC and any(map(_is_double, args)):
            args = tuple(
                torch.tensor(each, dtype=torch.float64) if isinstance(each, float) else each
                for each in args
            )
        return func(*args, **(kwargs or {}))


def _is_double(value: object) -> bool:
    return isinstance(value, Tensor) and value.dtype == torch.float64
