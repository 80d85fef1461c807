"""Rate of collecting experience into the replay buffer, with and without workers."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from navrl.benchmarks.measurement import Budget, threads
from navrl.benchmarks.results import Row
from navrl.training import Collector, Replay
from navrl.training.collectors import Phases

MakeSource = Callable[[int], tuple[Collector, Replay]]
"""Maps a number of workers (0 for this process) to a collector and an empty replay."""


def worker_rows(make: MakeSource, workers: Sequence[int], budget: Budget) -> list[Row]:
    """Measure collection without learning: worlds are stepped and transitions written.

    Also measured is the rate at which the receiving process stores frames without waiting, the
    upper bound for any number of workers.

    Args:
        make: Builds collector and replay.
        workers: Numbers of workers, increasing.
        budget: Duration and number of measurements.
    """
    direct, _ = frame_rates(*make(0), budget)
    rows = [Row("workers.direct", "collection in this process, one core", "/s", direct)]
    for count in workers:
        arrived, taken_in = frame_rates(*make(count), budget)
        label = f"… by {count} worker process{'es' if count > 1 else ''} of one core"
        rows.append(Row(f"workers.{count}", label, "/s", arrived))
    label = "… the receiving process could take in"
    return [*rows, Row("workers.intake", label, "/s", taken_in)]


def frame_rates(
    collector: Collector, replay: Replay, budget: Budget
) -> tuple[np.ndarray, np.ndarray]:
    """Measure the frame rates of a collector, which is closed afterwards.

    Args:
        collector: Collector that has not been started.
        replay: Replay buffer of the transitions.
        budget: Duration and number of measurements.

    Returns:
        Received frames per second, and received frames per second excluding waiting time;
        ``[repeats]`` each.
    """
    arrived, taken_in, frames = [], [], 0
    with threads(1):
        try:
            collector.start(0, max_dynamic=8)
            _collect(collector, replay, 4 * budget.seconds, frames)  # warm-up, not measured
            for _ in range(budget.repeats):
                count, seconds, waited = _collect(collector, replay, budget.seconds, frames)
                frames += count
                arrived.append(count / seconds)
                taken_in.append(count / (seconds - waited))
        finally:
            collector.close()
    return np.array(arrived), np.array(taken_in)


def _collect(
    collector: Collector, replay: Replay, min_s: float, frames: int
) -> tuple[int, float, float]:
    """Return frames, seconds, and the part of the seconds spent waiting."""
    phases, count, start = Phases(), 0, time.perf_counter()
    while (seconds := time.perf_counter() - start) < min_s or not count:
        stream, stepped = collector.step(frames + count, phases)
        replay.extend(stepped, stream)
        count += stepped.numel()
    return count, seconds, phases.seconds["wait"]
