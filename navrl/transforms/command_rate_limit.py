"""Limit of the change of a command to what the base can follow."""

from __future__ import annotations

from typing import Literal

from tensordict import NestedKey
from torch import Tensor

from navrl import keys
from navrl.checks import check_positive
from navrl.transforms.action_map import ActionMap
from navrl.transforms.base_motion import Base, base_of
from navrl.transforms.observation_map import Keys


class CommandRateLimit(ActionMap):
    """Limit a command to what the base can reach in one step from the last command.

    A base with limited acceleration drives the same with the limited command as with the requested
    one, since it cannot follow faster; but the commands are smooth, as drivers expect.
    A lag of the base is not considered: with one, the limited commands accelerate more slowly.

    Args:
        time_step: Time between two commands, s.
        scan_keys: Last command ``[*B, 2]`` (v, w), m/s and rad/s.
        action_key: Key of the command ``[*B, 2]``, on both sides.
        base: The base; ``"environment"`` for that of the environment or runner that the transform
            is a part of.

    Raises:
        ValueError: If ``time_step`` is not positive, or later if the environment has no known base.

    Example:
        >>> import torch
        >>> from navrl.sim import LimitedDrive
        >>> limit = CommandRateLimit(base=Base(LimitedDrive(linear_acceleration=0.5)))
        >>> limit.command(torch.tensor([[1.0, 0.0]]), torch.tensor([[0.2, 0.0]]))
        tensor([[0.3000, 0.0000]])

    Reference:
        Not in the paper. Velocity smoothers of mobile robots limit the change of commands likewise,
        e.g. Nav2's; behind a policy that does not know the base they add a delay.
    """

    def __init__(
        self,
        time_step: float = 0.2,
        scan_keys: Keys = (keys.COMMAND,),
        action_key: NestedKey | list[str] = keys.ACTION,
        base: Base | Literal["environment"] = "environment",
    ) -> None:
        super().__init__(("last command",), scan_keys, action_key)
        check_positive(time_step=time_step)
        if isinstance(base, str) and base != "environment":
            raise ValueError(f"base={base!r}: must be a Base or 'environment'")
        self.time_step, self.base = time_step, base

    def command(self, action: Tensor, *seen: Tensor) -> Tensor:
        """Return the limited commands ``[*B, 2]``, m/s and rad/s.

        Args:
            action: ``[*B, 2]``, requested (v, w).
            seen: Last commands ``[*B, 2]``.
        """
        base = self.base if isinstance(self.base, Base) else base_of(self)
        return base.robot.reachable(seen[0].to(action), action, self.time_step)
