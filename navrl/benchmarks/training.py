"""Phases of a short training, timed by the trainer."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from navrl.benchmarks.results import Row, at_most

PHASES = {  # phases of the trainer, with and without workers
    "act": "policy acts",
    "environment": "simulator and transforms",
    "wait": "waiting for workers",
    "push": "weights to workers",
    "replay_write": "replay, writing",
    "replay_sample": "replay, sampling",
    "update": "update",
}


def training_rows(log: Path, cores: int) -> list[Row]:
    """Read a training log, with one measurement per row.

    Args:
        log: The trainer's ``metrics.csv``. Its first row is excluded: it includes the steps before
            the first update.
        cores: Threads that it ran on.

    Raises:
        ValueError: If the log has fewer than two rows with timings.
    """
    with log.open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row.get("speed/frames_per_s")][1:]
    if not rows:
        raise ValueError(f"{log}: must have at least two rows with timings")

    def column(name: str) -> np.ndarray:
        return np.array([float(row[name]) for row in rows])

    timed = [phase for phase in PHASES if rows[0].get(f"seconds/{phase}")]
    seconds = {phase: column(f"seconds/{phase}") for phase in timed}
    total = np.sum(list(seconds.values()), axis=0)
    place = f"{cores} core{'s' if cores > 1 else ''}"
    found = [
        Row("training.frames", f"training, {place}: frames", "/s", column("speed/frames_per_s")),
        Row("training.updates", "… updates", "/s", column("speed/updates_per_s")),
    ]
    for phase, values in seconds.items():
        bar = at_most(10.0) if phase == "environment" else None
        label = f"… time in: {PHASES[phase]}"
        found.append(Row(f"training.{phase}", label, "%", 100 * values / total, bar))
    return found
