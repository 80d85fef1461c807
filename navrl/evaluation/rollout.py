"""Play fixed scenarios with a policy and record how each ends."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from navrl import keys
from navrl.envs import Outcome
from navrl.evaluation.metrics import Trajectory, measure
from navrl.ops.kernels.threads import torch_on_one_thread
from navrl.sim import Contact
from navrl.worlds import KINDS, ScenarioBatch

ERROR = "error"
"""The outcome of an episode that raised: an episode, and no success."""


class Preparing(Protocol):
    """A policy that is shown the scenarios before it plays them, as one that cheats needs to be.

    Having the method is enough: :func:`evaluate` calls it before each reset.
    """

    def prepare(self, scenarios: ScenarioBatch) -> Tensor | None:
        """Get ready to play ``scenarios``, one a world.

        Returns:
            ``[N]`` bool, which of them the policy knows how to win, or ``None`` if it does not
            plan that far.
        """

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write a normalized action."""


class Recorder(Protocol):
    """Sees every chunk that is played side by side, e.g. to keep its episodes. It only reads."""

    def begin(self, chunk: range) -> None:
        """Episodes ``chunk`` begin, one a world; after an error some begin once more."""

    def __call__(self, stepped: TensorDictBase) -> None:
        """A batch of transitions."""

    def end(self, chunk: range, records: list[EpisodeRecord]) -> None:
        """They ended as ``records`` say; never called of a chunk that raised."""


@dataclass(frozen=True)
class EpisodeRecord:
    """How one episode went.

    Args:
        index: Number within the suite.
        scenario: Kind of world.
        outcome: ``success``, ``collision_pedestrian``, ``collision_static``, ``timeout``; or
            ``error``, which counts as no success and is never dropped.
        steps: Until the end.
        time_s: s until the end.
        path_length_m: m driven.
        min_pedestrian_distance_m: m, least distance from hull to pedestrian, surface to surface.
        run_into: Whether a pedestrian moved into the robot rather than the robot into it.
        error: Traceback, if the episode raised.
        solved: Whether the policy knew beforehand how to win; ``None`` of one that does not plan.
        noise_seed: Of the lidar's noise.
        num_dynamic: Pedestrians who walk.
        num_static: Pedestrians who stand.
        pedestrian_speed_mps: m/s, mean speed of those who walk; ``None`` without any.
        metrics: Every metric of :data:`navrl.evaluation.metrics.METRICS` by name; ``None`` where it
            is not defined, empty after an error.
    """

    index: int
    scenario: str
    outcome: str
    steps: int
    time_s: float
    path_length_m: float
    min_pedestrian_distance_m: float
    run_into: bool = False
    error: str = ""
    solved: bool | None = None
    noise_seed: int = 0
    num_dynamic: int = 0
    num_static: int = 0
    pedestrian_speed_mps: float | None = None
    metrics: Mapping[str, float | None] = field(default_factory=dict)


@torch.no_grad()
def evaluate(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    scenarios: ScenarioBatch,
    on_step: Callable[[TensorDictBase], None] | None = None,
    on_chunk: Callable[[int], None] | None = None,
    recorder: Recorder | None = None,
    chunks: Iterable[range] | None = None,
) -> list[EpisodeRecord]:
    """Play each scenario once.

    Args:
        env: Environment over N worlds with ``privileged=True``; scenarios are played N at a time,
            in order, the last chunk padded by repetition.
        policy: Writes a normalized action; noise is off. If it has a method ``prepare``, it is
            shown what it is about to play (:class:`Preparing`).
        scenarios: What to play.
        on_step: Called with every batch of transitions, e.g. to record them; if an episode raises,
            with those of its neighbors once more.
        on_chunk: Called with the number of episodes finished since the last call.
        recorder: Told of each chunk and its transitions.
        chunks: Which episodes to play side by side; by default all, N at a time
            (:func:`side_by_side`).

    Returns:
        A record per scenario played, in order.
    """
    records: list[EpisodeRecord] = []
    chunks = side_by_side(len(scenarios), env.batch_size.numel()) if chunks is None else chunks
    before = env.base_env.set_scenarios(None)
    try:
        for chunk in chunks:
            records += _play_chunk(env, policy, scenarios, chunk, on_step, recorder)
            if on_chunk is not None:
                on_chunk(len(chunk))
    finally:
        env.base_env.set_scenarios(before)
    return records


def side_by_side(num_episodes: int, num_worlds: int) -> list[range]:
    """Cut episodes into what is played at a time: always the same, so that results are."""
    firsts = range(0, num_episodes, num_worlds)
    return [range(first, min(first + num_worlds, num_episodes)) for first in firsts]


def _play_chunk(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    scenarios: ScenarioBatch,
    chunk: range,
    on_step: Callable[[TensorDictBase], None] | None,
    recorder: Recorder | None,
) -> list[EpisodeRecord]:
    """Play the episodes of ``chunk`` side by side; if that raises, each half for itself.

    So an episode that raises neither stops the evaluation, nor vanishes from it, nor takes those
    with it that happened to be played beside it.
    """
    rows = torch.arange(chunk.start, chunk.start + env.batch_size.numel())
    batch = scenarios[rows.clamp_max(chunk[-1])]
    if recorder is not None:
        recorder.begin(chunk)
    watchers = [watcher for watcher in (on_step, recorder) if watcher is not None]
    try:
        series, solved = _play(env, policy, batch, watchers)
    except Exception:
        if len(chunk) == 1:
            return [_failed(batch, chunk.start, traceback.format_exc())]
        middle = len(chunk) // 2
        halves = chunk[:middle], chunk[middle:]
        play = partial(_play_chunk, env, policy, scenarios, on_step=on_step, recorder=recorder)
        return [record for half in halves for record in play(chunk=half)]
    trajectory = series.trajectory(env, batch[torch.arange(len(chunk))], len(chunk))
    metrics = {name: values.tolist() for name, values in measure(trajectory).items()}
    records = [
        _record(trajectory, metrics, batch, row, index, solved) for row, index in enumerate(chunk)
    ]
    if recorder is not None:
        recorder.end(chunk, records)
    return records


class _Series:
    """What metrics need of each step of N worlds."""

    def __init__(self, carrier: TensorDictBase) -> None:
        self._pose = [carrier[keys.POSE]]
        self._pedestrians = [carrier[keys.PEDESTRIAN_BOXES]]
        self._steps = torch.zeros(len(carrier), dtype=torch.int64, device=carrier.device)
        self._outcome, self._contact = self._steps, self._steps
        self.running = torch.ones_like(self._steps, dtype=torch.bool)

    def add(self, stepped: TensorDictBase) -> None:
        """Add a step; worlds that have ended stay ended."""
        following = stepped["next"]
        self._pose.append(following[keys.POSE])
        self._pedestrians.append(following[keys.PEDESTRIAN_BOXES])
        self._steps = self._steps + self.running
        ends = self.running & following["done"].squeeze(-1)
        self._outcome = torch.where(ends, following[keys.OUTCOME].squeeze(-1), self._outcome)
        self._contact = torch.where(ends, following[keys.CONTACT].squeeze(-1), self._contact)
        self.running = self.running & ~ends

    def trajectory(self, env: TransformedEnv, scenarios: ScenarioBatch, count: int) -> Trajectory:
        """Return the first ``count`` worlds' episodes."""
        simulator = env.base_env.simulator
        pose, pedestrians = (
            torch.stack(series, dim=1)[:count].cpu().numpy()
            for series in (self._pose, self._pedestrians)
        )
        last = (self._steps, self._outcome, self._contact)
        return Trajectory.from_series(
            scenarios,
            pose,
            pedestrians,
            *(value[:count].cpu().numpy() for value in last),
            time_step_s=simulator.time_step_s,
            robot_radius=simulator.robot.radius,
            max_speed=simulator.robot.max_speed,
        )


def _play(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    batch: ScenarioBatch,
    watchers: Sequence[Callable[[TensorDictBase], None]],
) -> tuple[_Series, Tensor | None]:
    env.base_env.set_scenarios(batch)
    solved = policy.prepare(batch) if hasattr(policy, "prepare") else None
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        with torch_on_one_thread():
            carrier = env.reset()
        series = _Series(carrier)
        while bool(series.running.any()):
            decided = policy(carrier)
            _check_action(decided[keys.ACTION], series.running)
            with torch_on_one_thread():
                stepped = env.step(decided)
            for watcher in watchers:
                watcher(stepped)
            series.add(stepped)
            env.base_env.simulator.rest(~series.running)
            carrier = step_mdp(stepped, exclude_action=False)  # controllers read their last action
    return series, solved


def _check_action(action: Tensor, running: Tensor) -> None:
    """Raise a ValueError if the action ``[N, 2]`` of a running world is not finite."""
    is_bad = running & ~action.isfinite().all(-1)
    if bool(is_bad.any()):
        raise ValueError(
            f"action={action[is_bad][0].tolist()}: must be finite, as policies write it"
        )


def _record(
    trajectory: Trajectory,
    metrics: Mapping[str, Sequence[float]],
    batch: ScenarioBatch,
    row: int,
    index: int,
    solved: Tensor | None,
) -> EpisodeRecord:
    steps = int(trajectory.num_steps[row])
    values = {name: _defined(column[row]) for name, column in metrics.items()}
    return EpisodeRecord(
        index=index,
        outcome=Outcome(int(trajectory.outcome[row])).name.lower(),
        steps=steps,
        time_s=steps * trajectory.time_step_s,
        path_length_m=values["path_length_m"],
        min_pedestrian_distance_m=values["min_pedestrian_distance_m"],
        run_into=int(trajectory.contact[row]) == Contact.RUN_INTO,
        solved=None if solved is None else bool(solved[row]),
        metrics=values,
        **_setting(batch, row),
    )


def _failed(batch: ScenarioBatch, index: int, error: str) -> EpisodeRecord:
    nan = float("nan")
    return EpisodeRecord(
        index=index,
        outcome=ERROR,
        steps=0,
        time_s=nan,
        path_length_m=nan,
        min_pedestrian_distance_m=nan,
        error=error,
        **_setting(batch, 0),
    )


def _setting(batch: ScenarioBatch, row: int) -> dict:
    """Return what the scenario in ``row`` is like."""
    present, standing = batch.ped_present[row], batch.ped_static[row]
    speeds = batch.ped_speed[row][present & ~standing]
    return {
        "scenario": KINDS[int(batch.kind[row])],
        "noise_seed": int(batch.noise_seed[row]),
        "num_dynamic": len(speeds),
        "num_static": int((present & standing).sum()),
        "pedestrian_speed_mps": float(speeds.mean()) if len(speeds) else None,
    }


def _defined(value: float) -> float | None:
    return None if math.isnan(value) else value
