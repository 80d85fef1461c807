"""Speeds of a policy that was trained to drive forwards, on a base that can reverse."""

from __future__ import annotations

import math

import torch
from tensordict import NestedKey
from torch import Tensor

from navrl import keys
from navrl.checks import check_positive
from navrl.transforms.action_map import ActionMap


class ForwardSpeeds(ActionMap):
    """Scale a policy's speeds to zero and above, on a base whose commands may be negative.

    A policy's action in [-1, 1] is scaled to the limits of the base. On a base that can reverse the
    same action is another speed, so a policy that was trained without reversing would back up where
    it meant to stop. This step restores its speeds; reversing is left to the steps after it, e.g.
    :class:`navrl.transforms.ActionShield`, which then finds more commands that avoid a contact.

    Args:
        min_speed: Smallest speed of the base, at most 0, m/s.
        max_speed: Largest speed of the base, m/s.
        action_key: Key of the command ``[*B, 2]`` (v, w), on both sides.

    Raises:
        ValueError: If a speed is out of range.

    Example:
        >>> forward = ForwardSpeeds(min_speed=-0.5, max_speed=1.0)
        >>> forward.command(torch.tensor([[-0.5, 0.3], [0.25, 0.3], [1.0, 0.3]]))
        tensor([[0.0000, 0.3000],
                [0.5000, 0.3000],
                [1.0000, 0.3000]])

    Reference:
        Not in the paper, whose robot does not reverse (Sec. IV-D).
    """

    def __init__(
        self,
        min_speed: float = 0.0,
        max_speed: float = 1.0,
        action_key: NestedKey | list[str] = keys.ACTION,
    ) -> None:
        """Check and store the arguments."""
        super().__init__((), (), action_key)
        check_positive(max_speed=max_speed)
        if not -math.inf < min_speed <= 0.0:
            raise ValueError(f"min_speed={min_speed}: must be at most 0 (m/s), and finite")
        self.min_speed, self.max_speed = min_speed, max_speed

    def command(self, action: Tensor, *seen: Tensor) -> Tensor:
        """Return the commands ``[*B, 2]``, m/s and rad/s."""
        speed, turn_rate = action.unbind(-1)
        share = (speed - self.min_speed) / (self.max_speed - self.min_speed)
        return torch.stack([share * self.max_speed, turn_rate], dim=-1)
