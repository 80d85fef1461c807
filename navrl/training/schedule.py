"""How much a training does of what, and how far it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Schedule:
    """How much of what, and how often.

    Args:
        total_frames: Environment steps (all worlds together) after which training ends.
        frames_per_update: Environment steps per gradient update.
        learning_starts: Environment steps before the first update.
        evaluate_every_updates: Updates between evaluations.
        log_every_updates: Updates between rows of the log.
        checkpoint_every_s: Wall-clock seconds between checkpoints.

    Raises:
        ValueError: If a value is not positive.
    """

    total_frames: int = 3_000_000
    frames_per_update: float = 32
    learning_starts: int = 10_000
    evaluate_every_updates: int = 2_000
    log_every_updates: int = 200
    checkpoint_every_s: float = 180.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value <= 0 and name != "learning_starts":
                raise ValueError(f"{name}={value}: must be > 0")


@dataclass
class Progress:
    """Counters of a run; all that is not a weight, a buffer or a world.

    Args:
        frames: Environment steps of all worlds.
        updates: Gradient updates.
        episodes: Episodes that ended.
        best_level: Curriculum level of the best evaluation; -1 before the first.
        best_success_rate: Its success rate.
        seconds: s of training.
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
        """Let later policies be compared with the saved one, which may be newer than a checkpoint.

        Args:
            saved: Its metrics; ``None`` if there is no saved policy.
            level: Curriculum level of the checkpoint, used for bundles from before their metrics
                held a level: a later policy has at least this one.
        """
        if saved is None:
            self.best_level, self.best_success_rate = -1, -1.0
        elif saved["frames"] > self.frames:
            self.best_level = int(saved.get("curriculum_level", level))
            self.best_success_rate = saved["success_rate"]
