"""Memory use of many worlds, in a separate process."""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from navrl.benchmarks.measurement import threads
from navrl.benchmarks.results import Row, at_most
from navrl.benchmarks.stepping import MakeEnv, RandomDrive

_NUM_STEPS = 5


def memory_row(make: MakeEnv, num_worlds: int) -> Row:
    """Measure the memory that ``num_worlds`` worlds add to a process with a single one.

    Args:
        make: Builds the environment; must be picklable.
        num_worlds: Number of worlds.
    """
    context = get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as first:  # compiles missing kernels
        first.submit(_drive, make, 1).result()
    with ProcessPoolExecutor(1, mp_context=context) as fresh:
        grown = fresh.submit(_grow, make, num_worlds).result()
    label = f"memory of {num_worlds:,} worlds, complete steps"
    return Row("memory.worlds", label, "MB", [grown], at_most(1000.0))


def _grow(make: Callable, num_worlds: int) -> float:
    """Return the increase of the process's peak memory, MB."""
    with threads(1):
        _drive(make, 1)
        before = _resident_mb()
        _drive(make, num_worlds)
    return max(_peak_mb() - before, 0.1)


def _drive(make: MakeEnv, num_worlds: int) -> None:
    drive = RandomDrive(make(num_worlds))
    for _ in range(_NUM_STEPS):
        drive()


def _resident_mb() -> float:
    """Return the process's memory, or its peak if the system does not report it."""
    file = Path("/proc/self/statm")
    if not file.is_file():
        return _peak_mb()
    return int(file.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def _peak_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6
