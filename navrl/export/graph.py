"""One step of a policy, from a scan to a command, as a module without hidden state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import ActionScaling, Compose, Transform, TransformedEnv

from navrl import keys
from navrl.deploy.sensor_env import SensorEnv, read_keys
from navrl.sim import Delays, Lidar, RobotModel
from navrl.transforms import Base
from navrl.transforms.min_pool import check_lidar
from navrl.worlds.scenario import MAX_PATH_POINTS

STARTED, COMMANDS = "started", "commands"


class DriveGraph(nn.Module):
    """Map sensor values and the state of the last step to a command and the next state.

    The transforms, the network and the scaling of the action are those of
    :class:`navrl.deploy.PolicyRunner`. What a transform reads of the step before is an input, and
    an output of the step before.
    """

    def __init__(
        self,
        transforms: Transform,
        actor: TensorDictModule,
        lidar: Lidar,
        robot: RobotModel,
        delays: Delays | None = None,
        time_step_s: float = 0.2,
    ) -> None:
        super().__init__()
        check_lidar(transforms, lidar)
        delays = Delays() if delays is None else delays
        self._base = Base(robot, delays.nominal_command_delays_s, delays.nominal_scan_age_s)
        env = TransformedEnv(SensorEnv(lidar, self._base), transforms.clone())
        env.append_transform(ActionScaling())
        env.action_spec  # noqa: B018
        self._env, self._steps, self.actor = env, list(cast(Compose, env.transform)), actor
        self._robot, self.time_step_s = robot, time_step_s
        needed = read_keys(transforms)
        ahead = {keys.MOTION_AHEAD, keys.VELOCITY_AHEAD} & needed
        moves = {keys.POSE, keys.SCAN_MOTION} & needed
        sensors = {keys.RANGES, keys.PATH} & needed | moves
        if keys.VELOCITY in needed or ahead:
            sensors.add(keys.VELOCITY)
        specs = env.base_env.observation_spec
        self.sensors = {k: specs[k].shape[1:] for k in specs.keys() if k in sensors}
        self.dtypes = {k: specs[k].dtype for k in self.sensors}
        count = max(1, math.ceil(max(self._base.command_delays_s) / time_step_s))
        self._num_commands = count if keys.COMMAND in needed or ahead else 0
        self.low, self.high = robot.bounds()
        self.state = self._find_state()

    def sensed(self, values: Mapping[str, Tensor], commands: Tensor | None) -> TensorDict:
        data = TensorDict(dict(values), [values[keys.RANGES].shape[0]])
        if commands is not None:
            data.set(keys.COMMAND, commands[:, 0])
            ahead = self._base.ahead(values[keys.VELOCITY], commands, self.time_step_s)
            data.set(keys.MOTION_AHEAD, ahead[0])
            data.set(keys.VELOCITY_AHEAD, ahead[1])
        return data

    def _find_state(self) -> dict[str, Tensor]:
        values = {k: torch.zeros(1, *s, dtype=self.dtypes[k]) for k, s in self.sensors.items()}
        commands = None
        if self._num_commands:
            commands = torch.zeros(1, self._num_commands, self._robot.command_size)
        past = self.sensed(values, commands)
        for step in self._steps:
            past = step._call(past)
        reads = _Reads(past)
        now = self.sensed(values, commands)
        for step in self._steps:
            now = step._step(reads, now) if _is_stateful(step) else step._call(now)
        state = {STARTED: torch.zeros(1, dtype=torch.bool)}
        if commands is not None:
            state[COMMANDS] = commands
        return state | {key: past.get(key) for key in dict.fromkeys(reads.names)}

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        count = len(self.sensors)
        values = dict(zip(self.sensors, inputs[:count], strict=True))
        state = dict(zip(self.state, inputs[count:], strict=True))
        started, commands = state.pop(STARTED), state.pop(COMMANDS, None)
        past = TensorDict(state, [started.shape[0]])
        now = self.sensed(values, commands)
        for step in self._steps:
            now = _observe(step, past, now, started)
        action = self.actor.module(*(now.get(key) for key in self.actor.in_keys))
        now.set(keys.ACTION, action)
        data = now
        for step in reversed(self._steps):
            if step.in_keys_inv:
                data = step._inv_call(data)
        command = torch.minimum(torch.maximum(data.get(keys.ACTION), self.low), self.high)
        after = {STARTED: torch.ones_like(started)}
        if commands is not None:
            after[COMMANDS] = torch.cat([command.unsqueeze(1), commands[:, :-1]], dim=1)
        after |= {key: now.get(key) for key in state}
        return (command, *(after[key] for key in self.state))


def _is_stateful(step: Transform) -> bool:
    return type(step)._step is not Transform._step


def _observe(step, past, now, started):
    if not _is_stateful(step):
        return step._call(now)
    first = step._call(now.copy())
    later = step._step(past, now.copy())
    for key in step.out_keys:
        is_later = started.reshape(-1, *[1] * (later.get(key).ndim - 1))
        now.set(key, torch.where(is_later, later.get(key), first.get(key)))
    return now


class _Reads:
    def __init__(self, data: TensorDictBase) -> None:
        self._data, self.names = data, []

    def get(self, key: str, *default: Any) -> Any:
        self.names.append(key)
        return self._data.get(key, *default)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._data, name)
