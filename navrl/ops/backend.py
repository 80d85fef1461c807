"""Backend selection: compiled Numba kernels or the torch reference implementation."""

import functools
import importlib.util
from typing import Literal

import torch
from torch import Tensor

from navrl.extras import install_hint

Backend = Literal["auto", "numba", "torch"]
BACKENDS = ("auto", "numba", "torch")


def is_compiled(backend: Backend, *inputs: Tensor) -> bool:
    """Return whether the compiled kernel should process these inputs.

    Args:
        backend: ``auto`` selects the kernel whenever it supports the inputs: float32 or float64
            tensors without gradients, on the CPU, or on a CUDA device if numba-cuda is installed
            and the caller is not in ``torch.compile``; never in ``torch.export``. ``numba``
            requires the kernel; ``torch`` selects the torch implementation.
        inputs: Tensors that the function reads.

    Raises:
        ValueError: If ``backend`` is unknown, or is ``numba`` and the kernel does not support the
            inputs.

    Example:
        >>> is_compiled("auto", torch.zeros(3)), is_compiled("torch", torch.zeros(3))
        (True, False)
    """
    if backend not in BACKENDS:
        raise ValueError(f"backend={backend!r}: must be one of {', '.join(BACKENDS)}")
    if backend == "torch" or (backend == "auto" and _needs_torch(inputs)):
        return False
    for tensor in inputs:
        obstacle = _obstacle(tensor)
        if obstacle is not None:
            if backend == "numba":
                raise ValueError(
                    f"backend='numba': must be 'auto' or 'torch' for {obstacle}, which the kernel "
                    "does not support"
                )
            return False
    return True


def _needs_torch(inputs: tuple[Tensor, ...]) -> bool:
    """Return whether the graph being traced should contain torch's operations."""
    if not torch.compiler.is_compiling():
        return False
    return torch.compiler.is_exporting() or any(not tensor.is_cpu for tensor in inputs)


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
    """Return an integer tensor as float32 and a floating-point tensor unchanged.

    Kernels write their results in the dtype of their input; an integer dtype would truncate them.

    Example:
        >>> as_real(torch.tensor([1, 2]))
        tensor([1., 2.])
    """
    return tensor if tensor.is_floating_point() else tensor.float()


@functools.cache
def missing_for_cuda() -> str | None:
    """Return the missing requirement for kernels on a CUDA device, ``None`` if all are met."""
    if not torch.cuda.is_available():
        return "a CUDA device that torch can use"
    if importlib.util.find_spec("numba_cuda") is None:
        return f"numba-cuda ({install_hint('cuda')})"
    return None


def find_device(device: torch.device | str) -> torch.device:
    """Resolve ``cpu`` or ``cuda`` to a torch device with its index.

    Raises:
        ValueError: If the device is neither, a requirement of it is missing, or it is not the
            current CUDA device.

    Example:
        >>> find_device("cpu")
        device(type='cpu')
    """
    kind, _, index = str(device).partition(":")
    if kind not in ("cpu", "cuda") or not (index.isdigit() or str(device) == kind):
        raise ValueError(f"device={str(device)!r}: must be cpu or cuda")
    if kind == "cpu":
        return torch.device("cpu")
    if missing_for_cuda() is not None:
        raise ValueError(f"device={str(device)!r}: needs {missing_for_cuda()}; device='cpu' works")
    current = torch.device("cuda", torch.cuda.current_device())
    if index and int(index) != current.index:
        raise ValueError(
            f"device={str(device)!r}: must be the current CUDA device, {current}; select another "
            "with CUDA_VISIBLE_DEVICES"
        )
    return current


def check_same_device(**tensors: Tensor) -> None:
    """Check that all tensors are on the same device.

    Raises:
        ValueError: If the devices differ; the message lists the device of each tensor.
    """
    if len({tensor.device for tensor in tensors.values()}) > 1:
        devices = ", ".join(f"{name} on {tensor.device}" for name, tensor in tensors.items())
        raise ValueError(f"{', '.join(tensors)}: must be on one device, got {devices}")
