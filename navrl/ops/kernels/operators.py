"""Kernels as operators of ``torch.library``, for ``torch.compile`` and ``torch.vmap``."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import torch
from torch import Tensor


class _Mapping(Protocol):
    batch_size: int  # members of torch.vmap


def is_traced() -> bool:
    """Return whether the caller is compiled, or mapped by ``torch.vmap``."""
    return torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active()


def operator(outputs: Callable, shared: Sequence[str] = ()) -> Callable:
    """Turn a function that runs a kernel into ``torch.ops.navrl.NAME`` while it is traced.

    A compiled graph then contains the kernel as one node, and ``torch.vmap`` joins the mapped
    dimension with the rows. Eager calls run the function itself: the dispatch of an operator takes
    about as long as the kernel for a few scans.

    Args:
        outputs: Maps the arguments of the function to tensors of the shapes and dtypes of its
            results, without computing them.
        shared: Names of tensor arguments without a dimension of rows. All other tensors, and all
            results, have the rows as first dimension.

    Returns:
        Decorator of a function with annotated arguments: tensors, numbers, strings.
    """

    def decorate(function: Callable) -> Callable:
        name = f"navrl::{function.__name__}"
        torch.library.define(name, torch.library.infer_schema(function, mutates_args=()))
        torch.library.impl(name, ("cpu", "cuda"), function)
        torch.library.register_fake(name, outputs)
        registered = getattr(torch.ops.navrl, function.__name__).default
        names = list(inspect.signature(function).parameters)
        rule = functools.partial(_map_rows, registered, names, shared)
        torch.library.register_vmap(name, rule)

        @functools.wraps(function)
        def call(*arguments: Any) -> Tensor | tuple[Tensor, ...]:
            return registered(*arguments) if is_traced() else function(*arguments)

        return call

    return decorate


def _map_rows(
    registered: Callable,
    names: Sequence[str],
    shared: Sequence[str],
    info: _Mapping,
    in_dims: tuple[int | None, ...],
    *arguments: Any,
) -> tuple[Any, Any]:
    """Return an operator's results for all members of ``torch.vmap``, and their dimensions."""
    size, joined, rows = info.batch_size, [], 0
    for name, dim, value in zip(names, in_dims, arguments, strict=True):
        if isinstance(value, Tensor) and name not in shared:
            mapped = value.expand(size, *value.shape) if dim is None else value.movedim(dim, 0)
            rows, value = mapped.shape[1], mapped.flatten(0, 1)
        elif isinstance(value, Tensor) and dim is not None:
            raise ValueError(f"{name}: must be the same for all members of torch.vmap")
        joined.append(value)
    results = registered(*joined)
    if isinstance(results, Tensor):
        return results.unflatten(0, (size, rows)), 0
    return tuple(result.unflatten(0, (size, rows)) for result in results), (0,) * len(results)
