"""Number formats of an update's matrix products; weights, targets and optimisers stay float32."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

PRECISIONS = ("auto", "bfloat16", "float32", "tfloat32")

_BFLOAT16_INSTRUCTIONS = ("avx512_bf16", "amx_bf16", "bf16")  # of x86, x86 and ARM


def choose_precision(device: torch.device) -> str:
    """Return the precision that updates are fastest in.

    A GPU rounds what it multiplies on the way in. A CPU with instructions for bfloat16 takes half
    the time with it; any other has to emulate it, which takes nine times as long as float32.
    """
    if device.type == "cuda":
        return "tfloat32"
    if device.type != "cpu" or not torch.backends.mkldnn.is_available():
        return "float32"
    found = torch.cpu.get_capabilities()
    return "bfloat16" if any(found.get(name) for name in _BFLOAT16_INSTRUCTIONS) else "float32"


class Precision:
    """A number format and the two contexts that bring it about.

    Args:
        name: One of :data:`PRECISIONS`; ``"auto"`` takes what :func:`choose_precision` says.
        device: That networks are on.

    Raises:
        ValueError: If ``name`` is another.
    """

    def __init__(self, name: str, device: torch.device) -> None:
        if name not in PRECISIONS:
            raise ValueError(f"precision={name!r}: must be one of {', '.join(PRECISIONS)}")
        self.name = choose_precision(device) if name == "auto" else name
        self._device = device

    @contextmanager
    def rounding(self) -> Iterator[None]:
        """Let a GPU round what it multiplies, forward and backward, if that is asked for."""
        before = torch.get_float32_matmul_precision()
        if self.name == "tfloat32":
            torch.set_float32_matmul_precision("high")
        try:
            yield
        finally:
            torch.set_float32_matmul_precision(before)

    def autocast(self) -> torch.autocast:
        """Return the context of losses, whose gradients then come in the same format."""
        return torch.autocast(self._device.type, torch.bfloat16, enabled=self.name == "bfloat16")
