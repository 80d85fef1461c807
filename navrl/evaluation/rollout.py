"""Evaluation loop: play fixed scenarios with a policy and record the outcomes."""

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
from navrl.envs.transformed import base_env
from navrl.evaluation.metrics import METRICS, Metric, Trajectory, measure
from navrl.evaluation.series import Series
from navrl.ops.kernels.threads import torch_on_one_thread
from navrl.sim import Contact, Simulator
from navrl.worlds import ScenarioBatch

ERROR = "error"
"""Outcome of an episode that raised an exception; counts as a failure."""


class Preparing(Protocol):
    """Interface of policies that read the scenarios in advance (privileged).

    :func:`evaluate` calls the method, if a policy has it, before each reset.
    """

    def prepare(self, scenarios: ScenarioBatch) -> Tensor | None:
        """Prepare for the next ``scenarios``, one per world.

        Returns:
            ``[N]`` bool, whether the policy has a plan for the episode, or ``None`` if it does not
            plan episodes.
        """
        ...

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write a normalized action."""
        ...


class Recorder(Protocol):
    """Interface of observers of chunks of episodes, e.g. to save recordings."""

    def begin(self, chunk: range) -> None:
        """Begin the episodes ``chunk``, one per world; after an error some are repeated."""

    def __call__(self, stepped: TensorDictBase) -> None:
        """Receive a batch of transitions."""

    def end(self, chunk: range, records: list[EpisodeRecord]) -> None:
        """Receive the records of the chunk; not called for a chunk that raised an exception."""


@dataclass(frozen=True)
class EpisodeRecord:
    """Record of one episode.

    Args:
        index: Index within the suite.
        scenario: Kind of world.
        outcome: ``success``, ``collision_pedestrian``, ``collision_static``, ``timeout``; or
            ``error``, which counts as a failure.
        steps: Number of steps.
        time_s: Duration, s.
        path_length_m: Driven distance, m.
        min_pedestrian_distance_m: Minimum distance to a pedestrian, surface to surface, m.
        hit_by_pedestrian: Whether a pedestrian moved into the robot.
        error: Traceback, if the episode raised an exception.
        solved: Whether the policy had a plan; ``None`` if it does not plan episodes.
        noise_seed: Seed of the lidar's noise.
        num_dynamic: Number of moving pedestrians.
        num_static: Number of stationary pedestrians.
        pedestrian_speed_mps: Mean speed of the moving pedestrians, m/s; ``None`` without any.
        metrics: Every measured metric by name; ``None`` if undefined, empty after an error.
    """

    index: int
    scenario: str
    outcome: str
    steps: int
    time_s: float
    path_length_m: float
    min_pedestrian_distance_m: float
    hit_by_pedestrian: bool = False
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
    metrics: Sequence[Metric] = METRICS,
) -> list[EpisodeRecord]:
    """Play each scenario once.

    Args:
        env: Environment over N worlds with ``privileged=True``; scenarios are played N at a time,
            in order; the last chunk is padded by repetition.
        policy: Writes a normalized action; noise is off. If it has a method ``prepare``, it is
            called with the next scenarios (:class:`Preparing`).
        scenarios: Scenarios to play.
        on_step: Called with every batch of transitions, e.g. to record them; if an episode raises,
            transitions of its chunk are repeated.
        on_chunk: Called with the number of episodes finished since the last call.
        recorder: Receives each chunk and its transitions.
        chunks: Episodes to play as one batch; by default all, N at a time (:func:`side_by_side`).
        metrics: Metrics to measure in each episode; navrl's own must be among them.

    Returns:
        A record per played scenario, in order.

    Raises:
        ConnectionError: If the connection to a remote policy ends.
        ValueError: If the policy needs to know where pedestrians will walk, and they react.
    """
    check_known_future(policy, base_env(env).simulator)
    records: list[EpisodeRecord] = []
    chunks = side_by_side(len(scenarios), env.batch_size.numel()) if chunks is None else chunks
    before = base_env(env).set_scenarios(None)
    try:
        for chunk in chunks:
            records += _play_chunk(env, policy, scenarios, chunk, on_step, recorder, metrics)
            if on_chunk is not None:
                on_chunk(len(chunk))
    finally:
        base_env(env).set_scenarios(before)
    return records


def check_known_future(policy: object, simulator: Simulator) -> None:
    """Check that pedestrians keep to their routes if the policy reads these as the future.

    Raises:
        ValueError: If the pedestrian model is reactive, naming it.
    """
    model = simulator.pedestrians
    if getattr(policy, "needs_known_future", False) and model.is_reactive:
        raise ValueError(
            f"pedestrians={type(model).__name__}: must not be reactive, {type(policy).__name__} "
            "plans with the routes of the scenario; pedestrians=scripted follows them"
        )


def side_by_side(num_episodes: int, num_worlds: int) -> list[range]:
    """Split episodes into fixed chunks, so that results do not depend on interruptions."""
    firsts = range(0, num_episodes, num_worlds)
    return [range(first, min(first + num_worlds, num_episodes)) for first in firsts]


def _play_chunk(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    scenarios: ScenarioBatch,
    chunk: range,
    on_step: Callable[[TensorDictBase], None] | None,
    recorder: Recorder | None,
    metrics: Sequence[Metric],
) -> list[EpisodeRecord]:
    """Play the episodes of ``chunk`` as a batch; if that raises, each half separately.

    So an exception in one episode neither stops the evaluation nor affects other episodes.
    """
    rows = torch.arange(chunk.start, chunk.start + env.batch_size.numel())
    batch = scenarios[rows.clamp_max(chunk[-1])]
    if recorder is not None:
        recorder.begin(chunk)
    watchers = [watcher for watcher in (on_step, recorder) if watcher is not None]
    try:
        series, solved = _play(env, policy, batch, watchers)
    except ConnectionError:
        raise  # of a remote policy: no fault of the episode, and the next one has it too
    except Exception:
        if len(chunk) == 1:
            return [_failed(batch, chunk.start, traceback.format_exc())]
        middle = len(chunk) // 2
        halves = chunk[:middle], chunk[middle:]
        watch = {"on_step": on_step, "recorder": recorder, "metrics": metrics}
        play = partial(_play_chunk, env, policy, scenarios, **watch)
        return [record for half in halves for record in play(chunk=half)]
    trajectory = series.trajectory(batch[torch.arange(len(chunk))], len(chunk))
    values = {name: found.tolist() for name, found in measure(trajectory, metrics).items()}
    records = [
        _record(trajectory, values, batch, row, index, solved) for row, index in enumerate(chunk)
    ]
    if recorder is not None:
        recorder.end(chunk, records)
    return records


def _play(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    batch: ScenarioBatch,
    watchers: Sequence[Callable[[TensorDictBase], None]],
) -> tuple[Series, Tensor | None]:
    base_env(env).set_scenarios(batch)
    solved = policy.prepare(batch) if hasattr(policy, "prepare") else None
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        with torch_on_one_thread():
            carrier = env.reset()
        series = Series(env, carrier)
        while bool(series.running.any()):
            decided = policy(carrier)
            _check_action(decided[keys.ACTION], series.running)
            with torch_on_one_thread():
                stepped = env.step(decided)
            for watcher in watchers:
                watcher(stepped)
            series.add(stepped)
            base_env(env).simulator.skip(~series.running)
            carrier = step_mdp(stepped, exclude_action=False)  # controllers read their last action
    return series, solved


def _check_action(action: Tensor, running: Tensor) -> None:
    """Raise a ValueError if the action ``[N, 2]`` of a running world is not finite."""
    is_bad = running & ~action.isfinite().all(-1)
    if bool(is_bad.any()):
        raise ValueError(
            f"action={action[is_bad][0].tolist()}: must be finite in a policy's output"
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
        hit_by_pedestrian=int(trajectory.contact[row]) == Contact.HIT_BY_PEDESTRIAN,
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
    """Return the properties of the scenario in ``row``."""
    present, static = batch.ped_present[row], batch.ped_static[row]
    speeds = batch.ped_speed[row][present & ~static]
    return {
        "scenario": batch.kind_of(row),
        "noise_seed": int(batch.noise_seed[row]),
        "num_dynamic": len(speeds),
        "num_static": int((present & static).sum()),
        "pedestrian_speed_mps": float(speeds.mean()) if len(speeds) else None,
    }


def _defined(value: float) -> float | None:
    return None if math.isnan(value) else value
