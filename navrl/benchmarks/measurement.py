"""Alternating measurement of the rates of several tasks."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch


@dataclass(frozen=True)
class Budget:
    """Amount of measurement.

    Args:
        seconds: Minimum duration of one measurement, s.
        repeats: Measurements per task.

    Raises:
        ValueError: If a value is not positive.
    """

    seconds: float
    repeats: int

    def __post_init__(self) -> None:
        if not self.seconds > 0 or self.repeats < 1:
            raise ValueError(
                f"seconds={self.seconds}: must be > 0; repeats={self.repeats}: must be >= 1"
            )


@dataclass(frozen=True)
class Task:
    """Task to be timed.

    Args:
        work: Function that does some work and returns its number of units.
        num_threads: Threads of torch and the compiled kernels during the work.
        prepare: Called before each ``work``, not measured; ``None`` for no preparation.
    """

    work: Callable[[], int]
    num_threads: int = 1
    prepare: Callable[[], None] | None = None


def alternate(tasks: Mapping[str, Task], budget: Budget) -> dict[str, np.ndarray]:
    """Measure all tasks alternately and repeatedly.

    Tasks alternate (A B B A) within seconds, so that a machine that slows down affects all of them.
    Each task runs once before the measurement, so compiled kernels and caches are warm.

    Args:
        tasks: Tasks by name.
        budget: Duration and number of measurements.

    Returns:
        Units per second, ``[repeats]`` for each name.
    """
    rates: dict[str, list[float]] = {name: [] for name in tasks}
    for task in tasks.values():
        with threads(task.num_threads):
            _run(task)
    order = list(tasks.items())
    with frozen_objects():
        for _ in range(budget.repeats):
            for name, task in order:
                with threads(task.num_threads):
                    rates[name].append(_rate(task, budget.seconds))
            order.reverse()
    return {name: np.array(values) for name, values in rates.items()}


def _rate(task: Task, seconds: float) -> float:
    """Return units per second of at least ``seconds`` of work."""
    units, elapsed = 0, 0.0
    if task.prepare is not None:
        while elapsed < seconds:
            done, took = _run(task)
            units, elapsed = units + done, elapsed + took
        return units / elapsed
    _wait_for_gpu()
    start = time.perf_counter()
    while elapsed < seconds:  # no synchronization between calls, which may overlap on a GPU
        units += task.work()
        elapsed = time.perf_counter() - start
    _wait_for_gpu()
    return units / (time.perf_counter() - start)


def _run(task: Task) -> tuple[int, float]:
    """Prepare and work once; return the units and the seconds of the work."""
    if task.prepare is not None:
        task.prepare()
    _wait_for_gpu()
    start = time.perf_counter()
    units = task.work()
    _wait_for_gpu()
    return units, time.perf_counter() - start


def _wait_for_gpu() -> None:
    """Wait until a used GPU has finished its work."""
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Set the number of threads of torch and the kernels within the block."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def frozen_objects() -> Iterator[None]:
    """Exclude all current objects from garbage collection, as in ``navrl-train``.

    Torch's modules have some hundred thousand objects, whose traversal takes milliseconds.
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
