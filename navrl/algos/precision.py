"""Precision of the matrix products of an update; weights and optimizers remain float32."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

PRECISIONS = ("auto", "bfloat16", "float32", "tfloat32")

_BFLOAT16_INSTRUCTIONS = ("avx512_bf16", "amx_bf16", "bf16")  # x86, x86 and ARM


def choose_precision(device: torch.device) -> str:
    """Return the precision with the fastest updates on a device.

    A GPU rounds the inputs of products in hardware. A CPU with bfloat16 instructions halves the
    time of float32; other CPUs emulate bfloat16, which takes nine times as long as float32.
    """
    if device.type == "cuda":
        return "tfloat32"
    if device.type != "cpu" or not torch.backends.mkldnn.is_available():
        return "float32"
    found = torch.cpu.get_capabilities()
    return "bfloat16" if any(found.get(name) for name in _BFLOAT16_INSTRUCTIONS) else "float32"


class Precision:
    """Number format of matrix products and the two contexts that select it.

    Args:
        name: One of :data:`PRECISIONS`; ``"auto"`` uses :func:`choose_precision`.
        device: Device of the networks.

    Raises:
        ValueError: If ``name`` is unknown.
    """

    def __init__(self, name: str, device: torch.device) -> None:
        if name not in PRECISIONS:
            raise ValueError(f"precision={name!r}: must be one of {', '.join(PRECISIONS)}")
        self.name = choose_precision(device) if name == "auto" else name
        self._device = device

    @contextmanager
    def rounding(self) -> Iterator[None]:
        """Enable TensorFloat32 products, forward and backward, if selected."""
        before = torch.get_float32_matmul_precision()
        if self.name == "tfloat32":
            torch.set_float32_matmul_precision("high")
        try:
            yield
        finally:
            torch.set_float32_matmul_precision(before)

    def autocast(self) -> torch.autocast:
        """Return the autocast context of the losses, which also sets the format of gradients."""
        return torch.autocast(self._device.type, torch.bfloat16, enabled=self.name == "bfloat16")
