"""Adam optimizer with states that can be moved between devices."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

_IMPLEMENTATION_OPTIONS = ("fused", "foreach", "capturable")  # implementation options, not loaded


def adam_optimizer(
    weights: Iterable[Tensor], learning_rate: float, fused: bool, capturable: bool
) -> torch.optim.Adam:
    """Return torch's Adam.

    Args:
        weights: Weights to optimize.
        learning_rate: Step size.
        fused: Whether to use the fused implementation with a single pass over memory.
        capturable: Whether steps can be recorded in a CUDA graph; the learning rate is then a
            tensor, because a graph would freeze a number.
    """
    weights = list(weights)
    rate = torch.tensor(learning_rate, device=weights[0].device) if capturable else learning_rate
    return torch.optim.Adam(weights, lr=rate, fused=fused, capturable=capturable)


def set_learning_rate(group: dict, value: float) -> None:
    """Set the learning rate of a parameter group, in place if it is a tensor."""
    if isinstance(group["lr"], Tensor):
        group["lr"].fill_(value)
    else:
        group["lr"] = value


def load_adam(optimizer: torch.optim.Adam, state: dict) -> None:
    """Load an optimizer state saved by any Adam on any device; own settings are retained."""
    own = [
        {name: group[name] for name in ("lr", *_IMPLEMENTATION_OPTIONS)}
        for group in optimizer.param_groups
    ]
    optimizer.load_state_dict(state)
    for group, kept in zip(optimizer.param_groups, own, strict=True):
        value = float(group["lr"])
        group.update(kept)
        set_learning_rate(group, value)
        for weight in group["params"]:
            if weight in optimizer.state:
                counts_there = bool(group["fused"] or group["capturable"])
                device = weight.device if counts_there else torch.device("cpu")
                moments = optimizer.state[weight]
                moments["step"] = moments["step"].to(device, torch.float32)
