"""One step of a policy, from a scan to a command, as a module without hidden state."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.envs import ActionScaling, Compose, Transform, TransformedEnv

from navrl import keys
from navrl.checks import check_positive
from navrl.deploy import SafetyLimits
from navrl.deploy.sensor_env import SensorEnv, read_keys
from navrl.export.guard import Guard
from navrl.sim import Delays, Lidar, RobotModel
from navrl.transforms import Base
from navrl.transforms.min_pool import check_lidar

STARTED = "started"  # [B] bool, whether the state holds an observation
COMMANDS = "commands"  # [B, D, C] last commands, latest first, e.g. (v, w) in m/s and rad/s
_AHEAD = (keys.MOTION_AHEAD, keys.VELOCITY_AHEAD)
_GIVEN = (keys.RANGES, keys.POSE, keys.PATH, keys.VELOCITY, keys.SCAN_MOTION)


class DriveGraph(nn.Module):
    """Map sensor values and the state of the last step to a command and the next state.

    Transforms, network, scaling of the action and checks are those of
    :class:`navrl.deploy.PolicyRunner`. What a step of the pipeline reads from the step before is an
    input, and an output for the step after. Where ``started`` is false, the state is ignored, as
    after :meth:`navrl.deploy.PolicyRunner.reset`.

    Args:
        transforms: Map raw observations to network inputs; they are cloned.
        actor: Writes an action in [-1, 1].
        lidar: Lidar of the training.
        robot: Limits of the command.
        limits: Conditions under which the robot may drive; defaults of
            :class:`navrl.deploy.SafetyLimits`.
        delays: Delays of scans and commands; ``None`` for none.
        time_step_s: Time between two steps, s, to which the delays relate.

    Attributes:
        sensors: Zeros ``[1, ...]`` for each sensor value that the policy reads, by key.
        state: Zeros ``[1, ...]`` for each value of the state, by key.

    Raises:
        ValueError: If the transforms do not fit the lidar, or the actor is not a network with the
            single output ``action``.
    """

    def __init__(
        self,
        transforms: Transform,
        actor: TensorDictModule,
        lidar: Lidar,
        robot: RobotModel,
        limits: SafetyLimits | None = None,
        delays: Delays | None = None,
        time_step_s: float = 0.2,
    ) -> None:
        """Check the arguments and find the inputs that the pipeline reads."""
        super().__init__()
        check_positive(time_step_s=time_step_s)
        check_lidar(transforms, lidar)
        if actor.out_keys != [keys.ACTION] or keys.ACTION in actor.in_keys:
            raise ValueError(f"actor.out_keys={actor.out_keys}: must be a network with ['action']")
        delays = Delays() if delays is None else delays
        self._base = Base(robot, delays.nominal_command_delays_s, delays.nominal_scan_age_s)
        env = TransformedEnv(SensorEnv(lidar, self._base), transforms.clone())
        env.append_transform(ActionScaling())
        env.action_spec  # noqa: B018, reports a mismatch now
        self._env, self._steps = env, list(_single_steps(cast(Compose, env.transform)))
        self._network, self._in_keys = actor.module, list(actor.in_keys)
        self._guard = Guard(lidar, robot, SafetyLimits() if limits is None else limits)
        self._low, self._high = robot.bounds()
        self.time_step_s, self.command_size = float(time_step_s), robot.command_size
        self._reads_measured = not lidar.coverage.is_full
        self.sensors = self._find_sensors(read_keys(transforms))
        self.state = self._find_state(keys.COMMAND in read_keys(transforms))

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the command ``[B, C]``, the state of the drive ``[B]`` and the next state.

        Args:
            inputs: The values of :attr:`sensors`, then of :attr:`state`, ``[B, ...]``.
        """
        sensors = dict(zip(self.sensors, inputs[: len(self.sensors)], strict=True))
        before = dict(zip(self.state, inputs[len(self.sensors) :], strict=True))
        started, commands = before[STARTED], before.get(COMMANDS)
        if commands is not None:  # a new drive has none
            commands = torch.where(_like(started, commands), commands, 0.0)
        past = TensorDict({key: before[key] for key in self._carried}, [started.shape[0]])
        now = self._observed(sensors, commands)
        for step in self._steps:
            now = _observe(step, past, now, started)
        now.set(keys.ACTION, self._network(*(now.get(key) for key in self._in_keys)))
        state = self._guard.sensed(
            sensors[keys.RANGES], sensors.get(keys.POSE), sensors.get(keys.PATH)
        )
        others = [sensors[key] for key in (keys.VELOCITY, keys.SCAN_MOTION) if key in sensors]
        asked = self._command(now)
        state, stored = self._guard.decided(state, asked, *others)
        limited = torch.minimum(torch.maximum(asked, self._low), self._high)
        command = torch.where((state == 0).unsqueeze(-1), limited, 0.0)  # 0: DriveState.DRIVE
        after = {STARTED: stored | started}
        if commands is not None:
            after[COMMANDS] = torch.cat([command.unsqueeze(1), commands[:, :-1]], dim=1)
        for key in self._carried:
            after[key] = torch.where(_like(stored, before[key]), now.get(key), before[key])
        return (command, state, *(after[key] for key in self.state))

    @property
    def _carried(self) -> list[str]:
        return [key for key in self.state if key not in (STARTED, COMMANDS)]

    def _observed(self, sensors: Mapping[str, Tensor], commands: Tensor | None) -> TensorDict:
        """Return the observations that the transforms read."""
        ranges = sensors[keys.RANGES]
        now = TensorDict(dict(sensors), [ranges.shape[0]])
        now.set(keys.RANGES, self._guard.cleaned(ranges))
        if self._reads_measured:
            now.set(keys.MEASURED, self._guard.usable(ranges))
        if commands is not None:
            now.set(keys.COMMAND, commands[:, 0])
        if keys.VELOCITY in sensors:
            given = now.get(keys.VELOCITY).unsqueeze(1) if commands is None else commands
            ahead = self._base.ahead(sensors[keys.VELOCITY], given, self.time_step_s)
            now.update(dict(zip(_AHEAD, ahead, strict=True)))
        return now

    def _command(self, now: TensorDictBase) -> Tensor:
        """Return the command ``[B, C]`` of the action."""
        for step in reversed(self._steps):
            if step.in_keys_inv:
                now = step._inv_call(now.copy())
        return now.get(keys.ACTION)

    def _find_sensors(self, needed: set[str]) -> dict[str, Tensor]:
        sensors = [key for key in _GIVEN if key in needed or key == keys.RANGES]
        if needed & set(_AHEAD) and keys.VELOCITY not in sensors:
            sensors.append(keys.VELOCITY)
        specs = self._env.base_env.observation_spec
        return {key: specs[key].zero() for key in sensors}

    def _find_state(self, reads_command: bool) -> dict[str, Tensor]:
        """Return zeros for what the steps read of the step before."""
        state = {STARTED: torch.zeros(1, dtype=torch.bool)}
        delay = max(self._base.command_delays_s)
        if reads_command or (delay and keys.VELOCITY in self.sensors):
            count = max(1, math.ceil(delay / self.time_step_s))
            state[COMMANDS] = torch.zeros(1, count, self.command_size)
        past = self._observed(self.sensors, state.get(COMMANDS))
        now = past.copy()
        for step in self._steps:
            past = step._call(past)
        reads = _Reads(past)
        for step in self._steps:
            reader = cast(TensorDictBase, reads)
            now = step._step(reader, now) if _is_stateful(step) else step._call(now)
        return state | {key: torch.zeros_like(past.get(key)) for key in dict.fromkeys(reads.names)}


def _single_steps(steps: Compose) -> Iterator[Transform]:
    """Return the steps of a chain, and those of chains within it, in order."""
    for step in cast(Sequence[Transform], steps.transforms):
        yield from _single_steps(step) if isinstance(step, Compose) else (step,)


class _Reads:
    """Observations of a step that record which of them are read."""

    def __init__(self, data: TensorDictBase) -> None:
        self._data = data
        self.names: list[str] = []

    def get(self, key: str, *default: Tensor | None) -> Tensor | None:
        self.names.append(key)
        return self._data.get(key, *default)

    def __getattr__(self, name: str) -> object:
        return getattr(self._data, name)


def _is_stateful(step: Transform) -> bool:
    return type(step)._step is not Transform._step


def _observe(
    step: Transform, past: TensorDictBase, now: TensorDictBase, started: Tensor
) -> TensorDictBase:
    """Return the observations with the outputs of a step, which begins where not ``started``."""
    if not _is_stateful(step):
        return step._call(now)
    first, later = step._call(now.copy()), step._step(past, now.copy())
    outputs: Sequence[str] = [key for key in step.out_keys if isinstance(key, str)]
    for key in outputs:
        is_later = _like(started, later.get(key))
        now.set(key, torch.where(is_later, later.get(key), first.get(key)))
    return now


def _like(flags: Tensor, values: Tensor) -> Tensor:
    """Return flags ``[B]`` that broadcast to values ``[B, ...]``."""
    return flags.reshape(-1, *[1] * (values.ndim - 1))
