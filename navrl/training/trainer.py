"""The training loop: collect, learn, evaluate, checkpoint."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import tqdm

from navrl import keys
from navrl.algos import DDPG, NonFiniteUpdateError
from navrl.envs import Outcome
from navrl.progress_bar import progress_bar
from navrl.training.checkpoint import CheckpointStore
from navrl.training.collectors import Collector, Phases
from navrl.training.curriculum import Curriculum
from navrl.training.metrics_log import MetricsLog
from navrl.training.replay import Replay
from navrl.training.schedule import Progress, Schedule

Evaluate = Callable[[int], Mapping[str, float]]
OnBest = Callable[[Mapping[str, float]], None]

MAX_BATCHES_DRAWN = 64  # at a time: some 60 MB of the paper's transitions


@dataclass
class _Window:
    """Sums since the last row of the log; tensors on their device, which nothing waits for."""

    terms: dict[str, torch.Tensor] = field(default_factory=lambda: defaultdict(float))
    outcomes: torch.Tensor | int = 0  # episodes ended, by outcome
    learning: dict[str, torch.Tensor] = field(default_factory=dict)
    phases: Phases = field(default_factory=Phases)
    frames: int = 0
    updates: int = 0


class Trainer:
    """Train a policy until the schedule ends; killed at any moment, it resumes.

    With :class:`navrl.training.DirectCollector` the resumed run is the same bit for bit. With
    workers the learner, its replay and its counters are, while workers start new episodes.

    Args:
        collector: Where experience comes from.
        sigma: Scale of the exploration noise after a number of frames, for the log.
        algorithm: What learns.
        replay: Where experience is kept.
        curriculum: Number of pedestrians.
        evaluate: Maps a maximum number of dynamic pedestrians to metrics with ``success_rate``.
        on_best: Called with the metrics of every evaluation that beats all before it, at the
            highest level reached so far.
        schedule: Amounts and intervals.
        folder: Run folder: ``metrics.csv``, ``tensorboard/``, ``checkpoint/``.
        progress_bar: Whether to show one.

    Reference:
        Paper Sec. V-A: regular evaluation; the best checkpoint of the highest level is kept.
    """

    def __init__(
        self,
        collector: Collector,
        sigma: Callable[[int], float],
        algorithm: DDPG,
        replay: Replay,
        curriculum: Curriculum,
        evaluate: Evaluate,
        on_best: OnBest,
        schedule: Schedule,
        folder: Path,
        progress_bar: bool = True,
    ) -> None:
        self.collector, self.sigma = collector, sigma
        self.algorithm, self.replay = algorithm, replay
        self.curriculum, self.evaluate, self.on_best = curriculum, evaluate, on_best
        self.schedule, self.folder, self.progress_bar = schedule, Path(folder), progress_bar
        self.checkpoints = CheckpointStore(self.folder / "checkpoint")
        self.progress = Progress()
        self._window = _Window()
        self._ended: torch.Tensor | int = 0  # episodes that the counter does not hold yet

    def run(self) -> Progress:
        """Train, resuming from the folder's checkpoint if there is one.

        Returns:
            The counters at the end.

        Raises:
            NonFiniteUpdateError: If an update is not finite; the batch and the weights before it
                are saved in ``<folder>/not_finite.pt``.
        """
        resumed = self.checkpoints.exists
        if resumed:
            self._restore()
        log = MetricsLog(self.folder, resume_frames=self.progress.frames if resumed else None)
        total, done = self.schedule.total_frames, self.progress.frames
        bar = progress_bar(total, "frame", initial=done, enabled=self.progress_bar)
        try:
            with set_exploration_type(ExplorationType.RANDOM):
                self._loop(log, bar)
        finally:
            self.collector.close()
            bar.close()
            log.close()
        return self.progress

    def _loop(self, log: MetricsLog, bar: tqdm) -> None:
        schedule, progress = self.schedule, self.progress
        self.collector.start(progress.frames, self.curriculum.max_dynamic)
        last_checkpoint = started = time.monotonic()
        seconds_before = progress.seconds
        while progress.frames < schedule.total_frames:
            bar.update(self._collect())
            before = progress.updates
            self._update(math.ceil(self._updates_due()) - progress.updates)
            progress.seconds = seconds_before + time.monotonic() - started
            if _crossed(before, progress.updates, schedule.log_every_updates):
                self._report(log, bar)
            if _crossed(before, progress.updates, schedule.evaluate_every_updates):
                self._evaluate(log)
            if time.monotonic() - last_checkpoint > schedule.checkpoint_every_s:
                self._save()
                last_checkpoint = time.monotonic()
        self._evaluate(log)
        self._save()

    def _updates_due(self) -> float:
        if not len(self.replay):  # n-step returns hold the first steps back
            return 0.0
        frames = self.progress.frames - self.schedule.learning_starts
        return frames / self.schedule.frames_per_update

    # --- one iteration ---------------------------------------------------------------------------

    def _collect(self) -> int:
        """Store what one step of some worlds gave; return the number of transitions."""
        window = self._window
        stream, stepped = self.collector.step(self.progress.frames, window.phases)
        with window.phases("replay_write"):
            self.replay.extend(stepped, stream)
        following = stepped["next"]
        for name, term in following[keys.REWARD_TERMS].items():
            window.terms[name] += term.sum().double()
        ended = _count_outcomes(following)
        window.outcomes = window.outcomes + ended
        self._ended = self._ended + ended.sum()
        frames = stepped.numel()
        window.frames += frames
        self.progress.frames += frames
        return frames

    def _count_episodes(self) -> None:
        """Bring the counter of episodes up to date."""
        self.progress.episodes += int(self._ended)
        self._ended = 0

    def _update(self, count: int) -> None:
        """Update as often; the batches are drawn together, since no transition comes between."""
        window = self._window
        self.algorithm.anneal(self.progress.frames / self.schedule.total_frames)
        for size in _shares(count):
            with window.phases("replay_sample"):
                batches = self.replay.sample(size)
            with window.phases("update"), self._keeps_failures():
                sums = self.algorithm.update_from_each(batches)
            for name, value in sums.items():
                window.learning[name] = window.learning.get(name, 0.0) + value
            window.updates += size
            self.progress.updates += size

    @contextmanager
    def _keeps_failures(self) -> Iterator[None]:
        """Save the batch and the weights before it if an update is not finite."""
        try:
            yield
        except NonFiniteUpdateError as error:
            file = self.folder / "not_finite.pt"
            state = {"batch": error.batch.to_dict(), "algorithm": self.algorithm.state_dict()}
            torch.save(state, file)
            error.add_note(f"the batch and the weights before it are in {file}")
            raise

    # --- reports ---------------------------------------------------------------------------------

    def _report(self, log: MetricsLog, bar: tqdm) -> None:
        window, self._window = self._window, _Window()
        self._count_episodes()
        seconds = sum(window.phases.seconds.values())
        outcomes = window.outcomes.tolist()
        ended = max(sum(outcomes), 1)
        rates = {
            f"train/{outcome.name.lower()}_rate": outcomes[outcome] / ended
            for outcome in Outcome
            if outcome is not Outcome.RUNNING
        }
        frames = max(window.frames, 1)
        log.log(
            self.progress.frames,
            self.progress.updates,
            {
                **{f"reward/{k}": float(v) / frames for k, v in window.terms.items()},
                **rates,
                **{f"learn/{k}": float(v) / window.updates for k, v in window.learning.items()},
                **{f"seconds/{k}": v / window.updates for k, v in window.phases.seconds.items()},
                "train/episodes": self.progress.episodes,
                "train/max_dynamic": self.curriculum.max_dynamic,
                "train/sigma": self.sigma(self.progress.frames),
                "speed/frames_per_s": window.frames / seconds,
                "speed/updates_per_s": window.updates / seconds,
            },
        )
        bar.set_postfix(
            success=f"{rates['train/success_rate']:.0%}",
            best=f"{max(self.progress.best_success_rate, 0):.0%}",
            people=self.curriculum.max_dynamic,
            updates_per_s=f"{window.updates / seconds:.1f}",
        )

    def _evaluate(self, log: MetricsLog) -> None:
        """Evaluate at the present level; keep the policy if best; perhaps raise the level."""
        progress, level = self.progress, self.curriculum.level
        start = time.monotonic()
        metrics = dict(self.evaluate(self.curriculum.max_dynamic))
        rate = metrics["success_rate"]
        row = {f"evaluation/{name}": value for name, value in metrics.items()}
        row["evaluation/max_dynamic"] = self.curriculum.max_dynamic
        row["seconds/evaluation"] = time.monotonic() - start
        log.log(progress.frames, progress.updates, row)
        if (level, rate) > (progress.best_level, progress.best_success_rate):
            progress.best_level, progress.best_success_rate = level, rate
            done = {name: getattr(progress, name) for name in ("frames", "updates", "seconds")}
            self.on_best({**metrics, **done})
        if self.curriculum.report(rate):
            self.collector.set_max_dynamic(self.curriculum.max_dynamic)

    # --- checkpoints -----------------------------------------------------------------------------

    def _save(self) -> None:
        self._count_episodes()
        self.checkpoints.save(
            {
                "progress": vars(self.progress),
                "curriculum_level": self.curriculum.level,
                "algorithm": self.algorithm.state_dict(),
                "replay": self.replay.save(self.checkpoints.journal),
                **self.collector.state_dict(),
                "rng": torch.get_rng_state(),
                **self._device_rng(),
            }
        )
        self.replay.prune(self.checkpoints.journal)

    def _restore(self) -> None:
        state = self.checkpoints.load()
        self.progress = Progress(**state["progress"])
        self.curriculum.level = state["curriculum_level"]
        self.algorithm.load_state_dict(state["algorithm"])
        self.replay.load(self.checkpoints.journal, state["replay"])
        self.collector.load_state_dict(state)
        if not self.collector.resumes_episodes:
            self.replay.forget_held_back()
        torch.set_rng_state(state["rng"])
        if "device_rng" in state and self.replay.device.type == "cuda":
            torch.cuda.set_rng_state(state["device_rng"], self.replay.device)

    def _device_rng(self) -> dict[str, torch.Tensor]:
        """Return the state of the learner's device's random numbers, if it has its own."""
        device = self.replay.device
        return {} if device.type == "cpu" else {"device_rng": torch.cuda.get_rng_state(device)}


def _shares(count: int) -> Iterator[int]:
    """Split a number of updates into numbers of batches that are drawn at a time."""
    for start in range(0, count, MAX_BATCHES_DRAWN):
        yield min(MAX_BATCHES_DRAWN, count - start)


def _crossed(before: int, after: int, interval: int) -> bool:
    return before // interval != after // interval


def _count_outcomes(following: TensorDictBase) -> torch.Tensor:
    """Return ``[outcomes]`` int64, how many of the episodes ended in which way at this step."""
    outcome, done = following[keys.OUTCOME].flatten(), following["done"].flatten()
    return outcome.new_zeros(len(Outcome)).index_add_(0, outcome, done.to(outcome.dtype))
