"""Training loop: collect, learn, evaluate, checkpoint."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import tqdm

from navrl.algos import Algorithm
from navrl.progress_bar import RemainingTime, progress_bar, shown_time
from navrl.training.checkpoint import (
    CheckpointStore,
    failures_saved,
    random_state,
    restore_random_state,
    resumable,
)
from navrl.training.collectors import Collector
from navrl.training.curriculum import Curriculum
from navrl.training.interruption import StopRequested, StopSignals, TrainingStoppedError
from navrl.training.loggers import Loggers, RunLogger, TensorBoard
from navrl.training.metrics_log import LOG_FILE, MetricsLog
from navrl.training.replay import Replay
from navrl.training.schedule import Progress, Schedule
from navrl.training.window import Window

Evaluate = Callable[[int], Mapping[str, float]]
OnBest = Callable[[Mapping[str, float]], None]
SavedBest = Callable[[], Mapping[str, float] | None]
Video = Callable[[int], Path | None]

MAX_BATCHES_DRAWN = 64  # sampled at a time; about 60 MB of the paper's transitions


class Trainer:
    """Training loop that can be killed at any time and resumed.

    With :class:`navrl.training.DirectCollector` a resumed run is identical bit for bit. With
    workers the learner, replay and counters are restored, but workers start new episodes.

    Args:
        collector: Source of experience.
        sigma: Maps a number of frames to the scale of the exploration noise, for the log.
        algorithm: Learning algorithm.
        replay: Replay buffer.
        curriculum: Curriculum on the number of pedestrians.
        evaluate: Maps a maximum number of dynamic pedestrians to metrics with ``success_rate``.
        on_best: Called with the metrics of every evaluation better than all previous ones, at the
            highest level reached so far.
        schedule: Length and intervals of the training.
        folder: Run folder: ``metrics.csv``, ``checkpoint/`` and the files of the loggers.
        progress_bar: Whether to show a progress bar.
        saved_best: Returns the metrics of the last policy saved by ``on_best``, ``None`` without
            one. A resumed run reads it, because that policy may be newer than the checkpoint.
        on_evaluated: Called with the metrics of every evaluation, before ``on_best``.
        loggers: Loggers by name, in addition to ``metrics.csv``; ``None`` for TensorBoard.
        hparams: Configuration by dotted name, for the loggers.
        video: Maps a frame count to a ``.gif`` of the policy, sent to the loggers after an
            evaluation, or to ``None``.

    Reference:
        Paper Sec. V-A: regular evaluation; the best checkpoint of the highest level is saved.
    """

    def __init__(
        self,
        collector: Collector,
        sigma: Callable[[int], float],
        algorithm: Algorithm,
        replay: Replay,
        curriculum: Curriculum,
        evaluate: Evaluate,
        on_best: OnBest,
        schedule: Schedule,
        folder: Path,
        progress_bar: bool = True,
        saved_best: SavedBest | None = None,
        on_evaluated: OnBest | None = None,
        loggers: Mapping[str, RunLogger] | None = None,
        hparams: Mapping[str, Any] | None = None,
        video: Video | None = None,
    ) -> None:
        self.collector, self.sigma = collector, sigma
        self.algorithm, self.replay = algorithm, replay
        self.curriculum, self.evaluate, self.on_best = curriculum, evaluate, on_best
        self.schedule, self.folder, self.progress_bar = schedule, Path(folder), progress_bar
        self.saved_best, self.on_evaluated = saved_best, on_evaluated
        self.loggers = {"tensorboard": TensorBoard()} if loggers is None else loggers
        self.hparams, self.video = hparams, video
        self.checkpoints = CheckpointStore(self.folder / "checkpoint")
        self.progress = Progress()
        self._window = Window()
        self._remaining = RemainingTime()
        self._ended: torch.Tensor | int = 0  # ended episodes not yet added to the counter
        self._log: MetricsLog  # made by run()
        self._signals = StopSignals()

    def run(self) -> Progress:
        """Train; resume from the checkpoint of the folder if there is one.

        Returns:
            The final counters.

        Raises:
            NonFiniteUpdateError: If an update is not finite; its batch and the weights before it
                are saved in ``<folder>/not_finite.pt``.
            TrainingStoppedError: If SIGTERM, SIGINT or SIGHUP was received; the run is saved.
            CheckpointError: If the checkpoint is damaged or a part of it is missing.
            OSError: If a file cannot be written, e.g. on a full disk; the checkpoint is retained.
        """
        resumed = self.checkpoints.exists
        rows = self._restore() if resumed else self.checkpoints.check_new(self.folder / LOG_FILE)
        frames = self.progress.frames if resumed else None
        loggers = Loggers(self.loggers, self.folder, frames, self.hparams)
        self._log = MetricsLog(self.folder, frames, rows, loggers)
        total, done = self.schedule.total_frames, self.progress.frames
        bar = progress_bar(total, "frame", initial=done, enabled=self.progress_bar, remaining=False)
        with StopSignals() as self._signals, resumable(self.folder):
            try:
                with set_exploration_type(ExplorationType.RANDOM):
                    self._start()
                    self._loop(bar)
            finally:
                self.collector.close()
                bar.close()
                self._log.close()
        return self.progress

    def _start(self) -> None:
        """Start the collector and save the first checkpoint of a new run."""
        self.collector.start(self._scheduled_frames, self.curriculum.max_dynamic)
        self._signals.install()
        if not self.checkpoints.exists:
            self._save()

    def _loop(self, bar: tqdm) -> None:
        schedule, progress = self.schedule, self.progress
        last_checkpoint = started = time.monotonic()
        seconds_before, updates_before = progress.seconds, progress.updates
        try:
            self._evaluate_if_due()  # a signal may have interrupted the last evaluation
            while schedule.share_done(progress) < 1.0:
                self._signals.check()
                bar.update(self._collect())
                before = progress.updates
                self._update(math.ceil(self._updates_due()) - progress.updates)
                progress.seconds = seconds_before + time.monotonic() - started
                if before == updates_before:  # frames without updates are much faster
                    self._remaining.restart(schedule.share_done(progress))
                if _crossed(before, progress.updates, schedule.log_every_updates):
                    self._report(bar)
                self._evaluate_if_due()
                if time.monotonic() - last_checkpoint > schedule.checkpoint_every_s:
                    self._save()
                    last_checkpoint = time.monotonic()
            if progress.evaluated_frames < progress.frames:
                self._evaluate()
            self._save()
            self._signals.check()
        except StopRequested:
            self._save()
            done = f"{progress.frames} of {schedule.total_frames} frames"
            assert self._signals.received is not None
            raise TrainingStoppedError(self._signals.received, done, self.folder) from None

    @property
    def _scheduled_frames(self) -> int:
        return self.schedule.scheduled_frames(self.progress)

    def _updates_due(self) -> float:
        if not len(self.replay):  # n-step returns delay the first steps
            return 0.0
        frames = self.progress.frames - self.schedule.learning_starts
        return frames / self.schedule.frames_per_update

    def _collect(self) -> int:
        """Collect and store one step of some worlds; return the number of transitions."""
        window = self._window
        stream, stepped = self._step()
        with window.phases("replay_write"):
            self.replay.extend(stepped, stream)
        self._ended = self._ended + window.add_step(stepped["next"])
        self.progress.frames += stepped.numel()
        return stepped.numel()

    def _step(self) -> tuple[int, TensorDictBase]:
        """Return the next step of the collector; a signal may interrupt workers."""
        try:
            with self._signals.immediate(enabled=not self.collector.resumes_episodes):
                return self.collector.step(self._scheduled_frames, self._window.phases)
        except RuntimeError:
            if self.collector.resumes_episodes or not self._signals.arrives():
                raise
            raise StopRequested from None  # the signal also ended the workers

    def _count_episodes(self) -> None:
        self.progress.episodes += int(self._ended)
        self._ended = 0

    def _update(self, count: int) -> None:
        """Take ``count`` gradient steps on batches sampled together."""
        window = self._window
        self.algorithm.anneal(self.schedule.share_done(self.progress))
        for size in _shares(count):
            with window.phases("replay_sample"):
                batches = self.replay.sample(size)
            with window.phases("update"), failures_saved(self.folder, self.algorithm):
                sums = self.algorithm.update_from_each(batches)
            window.add_updates(sums, size)
            self.progress.updates += size

    def _report(self, bar: tqdm) -> None:
        window, self._window = self._window, Window()
        self._count_episodes()
        row = {
            **window.row(),
            "train/episodes": self.progress.episodes,
            "train/max_dynamic": self.curriculum.max_dynamic,
            "train/sigma": self.sigma(self._scheduled_frames),
        }
        self._log.log(self.progress.frames, self.progress.updates, row)
        bar.set_postfix(
            left=shown_time(self._remaining.estimate(self.schedule.share_done(self.progress))),
            success=f"{row['train/success_rate']:.0%}",
            best=f"{max(self.progress.best_success_rate, 0):.0%}",
            people=self.curriculum.max_dynamic,
            updates_per_s=f"{row['speed/updates_per_s']:.1f}",
            refresh=False,  # in a file each refresh is a line
        )

    def _evaluate_if_due(self) -> None:
        progress, interval = self.progress, self.schedule.evaluate_every_updates
        if _crossed(progress.evaluated_updates, progress.updates, interval):
            self._evaluate()

    def _evaluate(self) -> None:
        """Evaluate at the current level, save the policy if it is best, update the curriculum."""
        progress, level = self.progress, self.curriculum.level
        start = time.monotonic()
        with self._signals.immediate():
            metrics = dict(self.evaluate(self.curriculum.max_dynamic))
        rate = metrics["success_rate"]
        row = {f"evaluation/{name}": value for name, value in metrics.items()}
        row["evaluation/max_dynamic"] = self.curriculum.max_dynamic
        row["seconds/evaluation"] = time.monotonic() - start
        self._log.log(progress.frames, progress.updates, row)
        progress.evaluated_frames, progress.evaluated_updates = progress.frames, progress.updates
        done = {name: getattr(progress, name) for name in ("frames", "updates", "seconds")}
        scored = {**metrics, **done, "curriculum_level": level}
        if self.on_evaluated is not None:
            self.on_evaluated(scored)
        if (level, rate) > (progress.best_level, progress.best_success_rate):
            progress.best_level, progress.best_success_rate = level, rate
            self.on_best(scored)
        if self.curriculum.report(rate):
            self.collector.set_max_dynamic(self.curriculum.max_dynamic)
        self._send_video()  # last: a signal may interrupt it, and a resume must not repeat the row

    def _send_video(self) -> None:
        """Play an episode and send its video to the loggers, if one is due."""
        if self.video is None:
            return
        with self._signals.immediate():
            file = self.video(self.progress.frames)
        self._log.log_video("evaluation/episode", file, self.progress.frames)

    def _save(self) -> None:
        self._count_episodes()
        self._log.synchronize()
        self.checkpoints.save(
            {
                "progress": vars(self.progress),
                "curriculum_level": self.curriculum.level,
                "algorithm": self.algorithm.state_dict(),
                "replay": self.replay.save(self.checkpoints.journal),
                "window": self._window.state_dict(),
                "log_rows": self._log.num_rows,
                **self.collector.state_dict(),
                **random_state(self.replay.device),
            }
        )
        self.replay.prune(self.checkpoints.journal)

    def _restore(self) -> int | None:
        """Load the last checkpoint; return its number of log rows, if known."""
        state = self.checkpoints.load()
        self.progress = Progress(**state["progress"])
        self.curriculum.level = state["curriculum_level"]
        self.algorithm.load_state_dict(state["algorithm"])
        self.replay.load(self.checkpoints.journal, state["replay"])
        self.collector.load_state_dict(state)
        if not self.collector.resumes_episodes:
            self.replay.discard_pending()
        if "window" in state:
            self._window = Window.from_state(state["window"])
        else:  # an older checkpoint without these keys, always saved after a due evaluation
            self.progress.evaluated_updates = self.progress.updates
        if self.saved_best is not None:
            self.progress.restore_best(self.saved_best(), self.curriculum.level)
        restore_random_state(state, self.replay.device)
        return state.get("log_rows")


def _shares(count: int) -> Iterator[int]:
    """Split a number of updates into numbers of batches sampled at a time."""
    for start in range(0, count, MAX_BATCHES_DRAWN):
        yield min(MAX_BATCHES_DRAWN, count - start)


def _crossed(before: int, after: int, interval: int) -> bool:
    return before // interval != after // interval
