"""Time series of the episodes that are played side by side, for their metrics."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from navrl import keys
from navrl.envs.transformed import base_env
from navrl.evaluation.metrics import Trajectory
from navrl.transforms.requested import is_shielded, requested_action
from navrl.worlds import ScenarioBatch


def true_pose(observed: TensorDictBase) -> Tensor:
    """Return ``[*B, 3]``, the true pose of a privileged observation."""
    return observed.get(keys.TRUE_POSE if keys.TRUE_POSE in observed else keys.POSE)


def requested_command(env: TransformedEnv, stepped: TensorDictBase) -> Tensor:
    """Return ``[*B, C]``, the policy's command in a transition before any shield.

    Args:
        env: Environment with the policy's transforms.
        stepped: Transition of ``env``.
    """
    driven = stepped["next", keys.COMMAND]
    if not is_shielded(env.transform):
        return driven
    return requested_action(env.transform, stepped.exclude("next")).to(driven.dtype)


class Series:
    """Time series of N worlds for the metrics.

    Args:
        env: Environment with the policy's transforms.
        carrier: Observation after the reset.
    """

    def __init__(self, env: TransformedEnv, carrier: TensorDictBase) -> None:
        self._env = env
        self._command: list[Tensor] = []
        self._requested: list[Tensor] = []
        self._pose = [true_pose(carrier)]
        self._pedestrians = [carrier[keys.PEDESTRIAN_BOXES]]
        self._steps = torch.zeros(len(carrier), dtype=torch.int64, device=carrier.device)
        self._outcome, self._contact = self._steps, self._steps
        self.running = torch.ones_like(self._steps, dtype=torch.bool)

    def add(self, stepped: TensorDictBase) -> None:
        """Add a step; worlds that have ended stay ended."""
        following = stepped.get("next")
        self._command.append(following[keys.COMMAND])
        self._requested.append(requested_command(self._env, stepped))
        self._pose.append(true_pose(following))
        self._pedestrians.append(following[keys.PEDESTRIAN_BOXES])
        self._steps = self._steps + self.running
        ends = self.running & following["done"].squeeze(-1)
        self._outcome = torch.where(ends, following[keys.OUTCOME].squeeze(-1), self._outcome)
        self._contact = torch.where(ends, following[keys.CONTACT].squeeze(-1), self._contact)
        self.running = self.running & ~ends

    def trajectory(self, scenarios: ScenarioBatch, count: int) -> Trajectory:
        """Return the first ``count`` worlds' episodes."""
        simulator = base_env(self._env).simulator
        series = (self._pose, self._pedestrians, self._command, self._requested)
        arrays = (torch.stack(steps, dim=1)[:count].cpu().numpy() for steps in series)
        last = (self._steps, self._outcome, self._contact)
        return Trajectory.from_series(
            scenarios,
            *arrays,
            *(value[:count].cpu().numpy() for value in last),
            time_step_s=simulator.time_step_s,
            robot_radius=simulator.robot.radius,
            max_speed=simulator.robot.top_speed,
        )
