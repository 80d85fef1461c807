"""Which implementation of a function runs: the compiled kernel or the torch form."""

import functools
import importlib.util
from typing import Literal

import torch
from torch import Tensor

from navrl.extras import install_hint

Backend = Literal["auto", "numba", "torch"]
BACKENDS = ("auto", "numba", "torch")


def is_compiled(backend: Backend, *inputs: Tensor) -> bool:
    """Return whether a kernel is to run on these inputs, the one for their device.

    Args:
        backend: ``auto`` takes the kernel wherever it can run: on tensors in single or double
            precision that no gradient flows through, outside of ``torch.compile``; on the CPU, and
            on a CUDA device if numba-cuda is installed. ``numba`` insists on it, ``torch`` on the
            torch form.
        inputs: what the function reads.

    Raises:
        ValueError: ``backend`` is unknown, or ``numba`` with inputs that it cannot take.
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend must be one of {', '.join(BACKENDS)}, got {backend!r}")
    if backend == "torch" or (backend == "auto" and torch.compiler.is_compiling()):
        return False
    for tensor in inputs:
        obstacle = _obstacle(tensor)
        if obstacle is not None:
            if backend == "numba":
                raise ValueError(f"backend 'numba' cannot take {obstacle}")
            return False
    return True


def _obstacle(tensor: Tensor) -> str | None:
    if tensor.device.type != "cpu":
        missing = "a CPU or CUDA device" if tensor.device.type != "cuda" else missing_for_cuda()
        if missing is not None:
            return f"a tensor on {tensor.device} without {missing}"
    if tensor.is_floating_point() and tensor.dtype not in (torch.float32, torch.float64):
        return f"a tensor of {tensor.dtype}"
    if tensor.requires_grad and torch.is_grad_enabled():
        return "a tensor that requires a gradient"
    return None


def as_real(tensor: Tensor) -> Tensor:
    """Return a tensor of integers as float32 and one of real numbers as it is.

    Kernels write their results in the dtype of their input, which would cut off fractions.
    """
    return tensor if tensor.is_floating_point() else tensor.float()


@functools.cache
def missing_for_cuda() -> str | None:
    """Return what is missing to run kernels on a CUDA device, ``None`` if nothing is."""
    if not torch.cuda.is_available():
        return "a CUDA device that torch can use"
    if importlib.util.find_spec("numba_cuda") is None:
        return f"numba-cuda ({install_hint('cuda')})"
    return None


def find_device(device: torch.device | str) -> torch.device:
    """Return the device that ``cpu`` or ``cuda`` stands for, with its index.

    Raises:
        ValueError: It is neither, or something is missing for it, naming what.
    """
    kind, _, index = str(device).partition(":")
    if kind not in ("cpu", "cuda") or not (index.isdigit() or str(device) == kind):
        raise ValueError(f"device must be cpu or cuda, got {str(device)!r}")
    if kind == "cpu":
        return torch.device("cpu")
    if missing_for_cuda() is not None:
        raise ValueError(f"device={str(device)!r} needs {missing_for_cuda()}; device='cpu' works")
    current = torch.device("cuda", torch.cuda.current_device())
    if index and int(index) != current.index:
        raise ValueError(
            f"device={str(device)!r}: the current CUDA device is {current}; choose another by "
            "CUDA_VISIBLE_DEVICES"
        )
    return current


def check_same_device(**tensors: Tensor) -> None:
    """Raise a ValueError that names each tensor's device unless all are on the same one."""
    if len({tensor.device for tensor in tensors.values()}) > 1:
        devices = ", ".join(f"{name} on {tensor.device}" for name, tensor in tensors.items())
        raise ValueError(f"all tensors must be on one device, got {devices}")
