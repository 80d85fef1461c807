"""Adam for any device, with states that move between devices."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

_WAY_OF_STEPPING = ("fused", "foreach", "capturable")  # not what is learned, but how it is computed


def adam_optimizer(
    weights: Iterable[Tensor], learning_rate: float, fused: bool, capturable: bool
) -> torch.optim.Adam:
    """Return torch's Adam.

    Args:
        weights: To optimise.
        learning_rate: Step size.
        fused: Whether one pass over memory does what a dozen would.
        capturable: Whether a CUDA graph can hold its steps; the learning rate is a tensor then,
            since the graph would hold a number for ever.
    """
    weights = list(weights)
    rate = torch.tensor(learning_rate, device=weights[0].device) if capturable else learning_rate
    return torch.optim.Adam(weights, lr=rate, fused=fused, capturable=capturable)


def set_learning_rate(group: dict, value: float) -> None:
    """Change a parameter group's learning rate, in place if it is a tensor."""
    if isinstance(group["lr"], Tensor):
        group["lr"].fill_(value)
    else:
        group["lr"] = value


def load_adam(optimizer: torch.optim.Adam, state: dict) -> None:
    """Load a state of Adam, however that one stepped and wherever: this one keeps to its way."""
    own = [
        {name: group[name] for name in ("lr", *_WAY_OF_STEPPING)}
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
