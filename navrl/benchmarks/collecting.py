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
"""From a number of workers, 0 for this process itself, to a collector and an empty replay."""


def worker_rows(make: MakeSource, workers: Sequence[int], budget: Budget) -> list[Row]:
    """Measure collection alone: worlds are stepped, transitions written, nothing is learned.

    Also measured is the rate at which the receiving process stores frames without waiting, the
    upper bound for any number of workers.

    Args:
        make: Builds what is measured.
        workers: Numbers of workers, increasing.
        budget: How long and how often.
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
    """Collect for a while; the collector is closed in the end.

    Args:
        collector: Not started yet.
        replay: Where the transitions go.
        budget: How long and how often.

    Returns:
        Frames a second that arrived, and frames a second of the time that was not spent waiting;
        ``[repeats]`` each.
    """
    arrived, taken_in, frames = [], [], 0
    with threads(1):
        try:
            collector.start(0, max_dynamic=8)
            _collect(collector, replay, 4 * budget.seconds, frames)  # unmeasured: all is warm
            for _ in range(budget.repeats):
                count, seconds, waited = _collect(collector, replay, budget.seconds, frames)
                frames += count
                arrived.append(count / seconds)
                taken_in.append(count / (seconds - waited))
        finally:
            collector.close()
    return np.array(arrived), np.array(taken_in)


def _collect(
    collector: Collector, replay: Replay, least_s: float, frames: int
) -> tuple[int, float, float]:
    """Return frames, seconds, and seconds of them spent waiting."""
    phases, count, start = Phases(), 0, time.perf_counter()
    while (seconds := time.perf_counter() - start) < least_s or not count:
        stream, stepped = collector.step(frames + count, phases)
        replay.extend(stepped, stream)
        count += stepped.numel()
    return count, seconds, phases.seconds["wait"]
