"""Conversion between physical commands and normalized actions."""

from __future__ import annotations

import functools

import torch
from tensordict import TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.sim import RobotModel


def normalized_action(robot: RobotModel, command: Tensor) -> Tensor:
    """Scale commands to normalized actions, the inverse of ``ActionScaling``.

    Args:
        robot: Robot whose limits become -1 and 1.
        command: ``[*B, 2]`` (v, w) m/s and rad/s; clipped to the limits.

    Returns:
        ``[*B, 2]`` in [-1, 1], float32.
    """
    low, high = _limits(robot.command_limits, torch.float64, command.device)
    action = (2 * command.double() - (low + high)) / (high - low)
    return action.clamp(-1.0, 1.0).float()


def physical_command(robot: RobotModel, action: Tensor) -> Tensor:
    """Scale actions ``[*B, 2]`` in [-1, 1] to (v, w), the inverse of :func:`normalized_action`."""
    low, high = _limits(robot.command_limits, action.dtype, action.device)
    return low + (action + 1) / 2 * (high - low)


def last_command(robot: RobotModel, tensordict: TensorDictBase) -> Tensor:
    """Return the command of the last step, read from the policy's own last action.

    Args:
        robot: Robot whose limits correspond to -1 and 1.
        tensordict: Input of a policy, ``[*B]``. Its ``action [*B, C]`` is that of the previous
            step, clipped to [-1, 1] as it was driven; it is missing before the first step, and NaN
            in worlds that were reset while others continued.

    Returns:
        ``[*B, C]``, e.g. (v, w), m/s and rad/s; zero (stationary) where there is no last action.
    """
    action = tensordict.get(keys.ACTION, None)
    if action is None:
        return torch.zeros(*tensordict.batch_size, robot.command_size, device=tensordict.device)
    return physical_command(robot, action.clamp(-1.0, 1.0)).nan_to_num(0.0)


@functools.lru_cache(maxsize=16)
def _limits(limits: tuple, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Return the limits as a cached tensor, since a copy to a device waits for the device."""
    return torch.tensor(limits, dtype=dtype, device=device)
