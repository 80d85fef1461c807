"""Command that a policy requests before a shield replaces it."""

from __future__ import annotations

from collections.abc import Iterator

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, Transform

from navrl import keys
from navrl.transforms.action_shield import ActionShield


def is_shielded(transform: Transform) -> bool:
    """Return whether a pipeline has a shield."""
    return any(isinstance(step, ActionShield) for step in _leaves(transform))


def requested_action(transform: Transform, decided: TensorDictBase) -> Tensor:
    """Return ``[*B, C]``, the policy's command before any shield.

    Args:
        transform: Transforms of the policy, scaling of the action included.
        decided: Observation with the normalized ``action``; it is not modified.
    """
    before = decided
    for step in reversed(list(_leaves(transform))):
        if not isinstance(step, ActionShield):
            before = step.inv(before)
    return before[keys.ACTION]


def _leaves(transform: Transform) -> Iterator[Transform]:
    """Yield the transforms of nested chains in order."""
    for step in transform if isinstance(transform, Compose) else ():
        yield from _leaves(step)
    if not isinstance(transform, Compose):
        yield transform
