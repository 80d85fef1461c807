"""Play fixed scenarios with a policy and record how each ends."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from navrl import keys
from navrl.envs import Outcome
from navrl.sim import Contact
from navrl.worlds import KINDS, ScenarioBatch

ERROR = "error"


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
        """Write a normalised action."""


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
        policy: Writes a normalised action; noise is off. If it has a method ``prepare``, it is
            shown what it is about to play (:class:`Preparing`).
        scenarios: What to play.
        on_step: Called with every batch of transitions, e.g. to record them; if an episode raises,
            with those of its neighbours once more.
        on_chunk: Called with the number of episodes finished since the last call.
        recorder: Told of each chunk and its transitions.
        chunks: Which episodes to play side by side; by default all, N at a time
            (:func:`side_by_side`).

    Returns:
        A record per scenario played, in order.
    """
    records: list[EpisodeRecord] = []
    for chunk in side_by_side(len(scenarios), env.batch_size.numel()) if chunks is None else chunks:
        records += _play_chunk(env, policy, scenarios, chunk, on_step, recorder)
        if on_chunk is not None:
            on_chunk(len(chunk))
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
        tally = _play(env, policy, batch, watchers)
    except Exception:
        if len(chunk) == 1:
            return [_failed(batch, chunk.start, traceback.format_exc())]
        middle = len(chunk) // 2
        halves = chunk[:middle], chunk[middle:]
        play = partial(_play_chunk, env, policy, scenarios, on_step=on_step, recorder=recorder)
        return [record for half in halves for record in play(chunk=half)]
    records = [_record(tally, batch, row, index) for row, index in enumerate(chunk)]
    if recorder is not None:
        recorder.end(chunk, records)
    return records


@dataclass
class _Tally:
    outcome: Tensor
    contact: Tensor
    steps: Tensor
    length: Tensor
    clearance: Tensor
    time_step_s: float
    solved: Tensor | None

    def cpu(self) -> _Tally:
        """Return it on the CPU, where it is read number by number."""
        moved = {k: v.cpu() for k, v in vars(self).items() if isinstance(v, Tensor)}
        return replace(self, **moved)


def _play(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    batch: ScenarioBatch,
    watchers: Sequence[Callable[[TensorDictBase], None]],
) -> _Tally:
    base = env.base_env
    base.set_scenarios(batch)
    solved = policy.prepare(batch) if hasattr(policy, "prepare") else None
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        carrier = env.reset()
        zeros = torch.zeros(len(batch), dtype=torch.int64, device=env.device)
        tally = _Tally(
            outcome=zeros,
            contact=zeros,
            steps=zeros.clone(),
            length=zeros.float(),
            clearance=carrier[keys.PEDESTRIAN_CLEARANCE].squeeze(-1).clone(),
            time_step_s=base.simulator.time_step_s,
            solved=solved,
        )
        running = torch.ones_like(zeros, dtype=torch.bool)
        while bool(running.any()):
            stepped = env.step(policy(carrier))
            for watcher in watchers:
                watcher(stepped)
            running = _count(tally, running, stepped)
            carrier = step_mdp(stepped)
    return tally.cpu()


def _count(tally: _Tally, running: Tensor, stepped: TensorDictBase) -> Tensor:
    """Add a step of the worlds that still run; return which go on."""
    following = stepped["next"]
    moved = following[keys.POSE][:, :2] - stepped[keys.POSE][:, :2]
    clearance = following[keys.PEDESTRIAN_CLEARANCE].squeeze(-1)
    tally.length += torch.where(running, moved.norm(dim=-1), 0.0)
    tally.clearance = torch.where(
        running, torch.minimum(tally.clearance, clearance), tally.clearance
    )
    tally.steps += running
    ends = running & following["done"].squeeze(-1)
    tally.outcome = torch.where(ends, following[keys.OUTCOME].squeeze(-1), tally.outcome)
    tally.contact = torch.where(ends, following[keys.CONTACT].squeeze(-1), tally.contact)
    return running & ~ends


def _record(tally: _Tally, batch: ScenarioBatch, row: int, index: int) -> EpisodeRecord:
    steps = int(tally.steps[row])
    return EpisodeRecord(
        index=index,
        scenario=KINDS[int(batch.kind[row])],
        outcome=Outcome(int(tally.outcome[row])).name.lower(),
        steps=steps,
        time_s=steps * tally.time_step_s,
        path_length_m=float(tally.length[row]),
        min_pedestrian_distance_m=float(tally.clearance[row]),
        run_into=int(tally.contact[row]) == Contact.RUN_INTO,
        solved=None if tally.solved is None else bool(tally.solved[row]),
    )


def _failed(batch: ScenarioBatch, index: int, error: str) -> EpisodeRecord:
    nan = float("nan")
    return EpisodeRecord(index, KINDS[int(batch.kind[0])], ERROR, 0, nan, nan, nan, error=error)
