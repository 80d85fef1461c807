"""Training schedule and progress counters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from navrl.checks import check_counts, check_positive


@dataclass(frozen=True)
class Schedule:
    """Length and intervals of a training.

    Args:
        total_frames: Environment steps (sum over all worlds) after which training ends.
        total_seconds: Duration after which training ends, s; ``None`` for no limit. Learning rates,
            exploration and the end follow the larger share of frames and of seconds. A clock is
            read, so a training with it cannot be repeated bit for bit.
        frames_per_update: Environment steps per gradient update.
        learning_starts: Environment steps before the first update.
        evaluate_every_updates: Updates between evaluations.
        log_every_updates: Updates between rows of the log.
        checkpoint_every_s: Wall-clock seconds between checkpoints.

    Raises:
        ValueError: If a value is not positive, ``learning_starts`` is negative, or a number of
            frames or updates is fractional.
    """

    total_frames: int = 3_000_000
    frames_per_update: float = 32
    learning_starts: int = 10_000
    evaluate_every_updates: int = 2_000
    log_every_updates: int = 200
    checkpoint_every_s: float = 180.0
    total_seconds: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        check_counts(
            total_frames=self.total_frames,
            evaluate_every_updates=self.evaluate_every_updates,
            log_every_updates=self.log_every_updates,
        )
        check_positive(frames_per_update=self.frames_per_update)
        if self.total_seconds is not None:
            check_positive(total_seconds=self.total_seconds)
        if not self.checkpoint_every_s > 0:  # infinite: at the start and the end only
            raise ValueError(f"checkpoint_every_s={self.checkpoint_every_s}: must be > 0 (s)")
        if not self.learning_starts >= 0:
            raise ValueError(f"learning_starts={self.learning_starts}: must be >= 0")

    def share_done(self, progress: Progress) -> float:
        """Return the completed share of the training, in frames or in seconds; 1 at its end.

        Example:
            >>> Schedule(total_frames=100, total_seconds=60.0).share_done(Progress(25, seconds=45))
            0.75
        """
        share = progress.frames / self.total_frames
        if self.total_seconds is None:
            return share
        return max(share, progress.seconds / self.total_seconds)

    def scheduled_frames(self, progress: Progress) -> int:
        """Return the frames at which schedules in frames are read: more if seconds are further."""
        if self.total_seconds is None:
            return progress.frames
        return max(progress.frames, int(self.share_done(progress) * self.total_frames))


@dataclass
class Progress:
    """Progress counters of a run.

    Args:
        frames: Environment steps of all worlds.
        updates: Gradient updates.
        episodes: Completed episodes.
        best_level: Curriculum level of the best evaluation; -1 before the first.
        best_success_rate: Success rate of the best evaluation.
        seconds: Duration of the training, s.
        evaluated_frames: ``frames`` at the last evaluation; -1 before the first.
        evaluated_updates: ``updates`` at the last evaluation.
    """

    frames: int = 0
    updates: int = 0
    episodes: int = 0
    best_level: int = -1
    best_success_rate: float = -1.0
    seconds: float = 0.0
    evaluated_frames: int = -1
    evaluated_updates: int = 0

    def restore_best(self, saved: Mapping[str, float] | None, level: int) -> None:
        """Restore the best evaluation from the saved policy, which may be newer than a checkpoint.

        Args:
            saved: Metrics of the saved policy; ``None`` if there is none.
            level: Curriculum level of the checkpoint, for older bundles whose metrics have no
                level; a later policy has at least this level.
        """
        if saved is None:
            self.best_level, self.best_success_rate = -1, -1.0
        elif saved["frames"] > self.frames:
            self.best_level = int(saved.get("curriculum_level", level))
            self.best_success_rate = saved["success_rate"]
