"""How much a training does of what, and how far it is."""

from __future__ import annotations

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
    """Counters of a run; all that is not a weight, a buffer or a world."""

    frames: int = 0
    updates: int = 0
    episodes: int = 0
    best_level: int = -1
    best_success_rate: float = -1.0
    seconds: float = 0.0
