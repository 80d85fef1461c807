"""Import of RVO2 and obstacles for it."""

from __future__ import annotations

from types import ModuleType

import torch
from torch import Tensor

from navrl.extras import install_hint
from navrl.ops import se2


def import_rvo(user: str) -> ModuleType:
    """Return the module ``pyrvo``.

    Args:
        user: Choice that needs it, e.g. ``policy=orca``.

    Raises:
        ImportError: If it is not installed; the message has the command.
    """
    try:
        import pyrvo
    except ImportError as error:
        hint = install_hint("orca")
        raise ImportError(f"{user}: needs pyrvo (RVO2, Apache-2.0); {hint}") from error
    return pyrvo


def corners(boxes: Tensor) -> Tensor:
    """Return the corners ``[..., 4, 2]`` m, counter-clockwise, of boxes ``[..., 5]``."""
    signs = torch.tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]).to(boxes)
    offsets = signs * boxes[..., None, 2:4]
    return boxes[..., None, :2] + se2.rotate(offsets, boxes[..., 4:])
