"""From physical commands to the normalised actions that policies write."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.sim import DifferentialDrive


def normalized_action(robot: DifferentialDrive, command: Tensor) -> Tensor:
    """Scale commands to what the environment's ``ActionScaling`` undoes.

    Args:
        robot: Whose limits become -1 and 1.
        command: ``[*B, 2]`` (v, w) m/s and rad/s; clipped to the limits.

    Returns:
        ``[*B, 2]`` in [-1, 1], float32.
    """
    low, high = torch.tensor(robot.command_limits, dtype=torch.float64, device=command.device)
    action = (2 * command.double() - (low + high)) / (high - low)
    return action.clamp(-1.0, 1.0).float()


def physical_command(robot: DifferentialDrive, action: Tensor) -> Tensor:
    """Undo :func:`normalized_action`: ``[*B, 2]`` in [-1, 1] to (v, w)."""
    low, high = torch.tensor(robot.command_limits, dtype=action.dtype, device=action.device)
    return low + (action + 1) / 2 * (high - low)
