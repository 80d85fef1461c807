"""Rows of a kernel shared among threads: the kernel lets go of Python's lock while it runs.

Numba's own parallel loops were tried first: on two threads a scan took each of them twice as long
as the plain loop takes one, and their pools either die in a fork or abort the process when two
Python threads launch at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import torch

MIN_ROWS = 8  # of a thread: to hand over fewer takes longer than to work on them
CHUNKS = 4  # a thread: who has the easier rows, or the idler core, takes more of them


def run_rows(work: Callable, num_rows: int, arguments: tuple) -> None:
    """Call ``work((start, stop), *arguments)`` until all rows are done, on torch's threads' number.

    A row's result depends on nothing but its own arguments, so the number of threads
    (``torch.set_num_threads``, ``OMP_NUM_THREADS``) changes none. One thread runs in place.

    Raises:
        Exception: What ``work`` raised, after all threads have ended.
    """
    num_threads = min(torch.get_num_threads(), num_rows // MIN_ROWS)
    if num_threads <= 1:
        work((0, num_rows), *arguments)
        return
    size = max(MIN_ROWS, -(-num_rows // (CHUNKS * num_threads)))
    starts = iter(range(0, num_rows, size))

    def take_chunks() -> None:
        for start in starts:  # one at a time: Python's lock is held
            work((start, min(start + size, num_rows)), *arguments)

    others = [_POOL.submit(take_chunks) for _ in range(num_threads - 1)]
    try:
        take_chunks()
    finally:
        for other in others:
            other.result()


class _Pool:
    """Threads that wait for work; a forked child, which inherits none of them, gets new ones."""

    def __init__(self) -> None:
        self._renew()
        if hasattr(os, "register_at_fork"):  # not on Windows
            os.register_at_fork(after_in_child=self._renew)

    def _renew(self) -> None:
        self._executor = ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="navrl-kernel")

    def submit(self, work: Callable):
        return self._executor.submit(work)


_POOL = _Pool()
