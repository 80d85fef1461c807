"""Which implementation of a function runs: the compiled kernel or the torch form."""

from typing import Literal

import torch
from torch import Tensor

Backend = Literal["auto", "numba", "torch"]
BACKENDS = ("auto", "numba", "torch")


def is_compiled(backend: Backend, *inputs: Tensor) -> bool:
    """Return whether the kernel is to run on these inputs.

    Args:
        backend: ``auto`` takes the kernel wherever it can run: on CPU tensors in single or double
            precision that no gradient flows through, outside of ``torch.compile``. ``numba``
            insists on it, ``torch`` on the torch form.
        inputs: what the function reads.

    Raises:
        ValueError: ``backend`` is unknown, or ``numba`` with inputs that it cannot take.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend must be one of {', '.join(BACKENDS)}, got {backend!r}")
    if backend == "torch" or (backend == "auto" and torch.compiler.is_compiling()):
        return False
    for tensor in inputs:
        obstacle = None
        if tensor.device.type != "cpu":
            obstacle = f"a tensor on {tensor.device}"
        elif tensor.is_floating_point() and tensor.dtype not in (torch.float32, torch.float64):
            obstacle = f"a tensor of {tensor.dtype}"
        elif tensor.requires_grad and torch.is_grad_enabled():
            obstacle = "a tensor that requires a gradient"
        if obstacle is not None:
            if backend == "numba":
                raise ValueError(f"backend 'numba' cannot take {obstacle}")
            return False
    return True


def check_same_device(**tensors: Tensor) -> None:
    """Raise a ValueError that names each tensor's device unless all are on the same one."""
    if len({tensor.device for tensor in tensors.values()}) > 1:
        devices = ", ".join(f"{name} on {tensor.device}" for name, tensor in tensors.items())
        raise ValueError(f"all tensors must be on one device, got {devices}")
