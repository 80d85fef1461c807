"""Rows of a kernel shared among threads: the kernel lets go of Python's lock while it runs.

Numba's own parallel loops were tried first: on two threads a scan took each of them twice as long
as the plain loop takes one, and their pools either die in a fork or abort the process when two
Python threads launch at once.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator

import torch

MIN_ROWS = 8  # of a thread: to hand over fewer takes longer than to work on them
CHUNKS = 8  # a thread: who has the easier rows, or the idler core, takes more of them

_alone: int | None = None  # threads of the kernels while torch has one


def run_rows(work: Callable, num_rows: int, arguments: tuple) -> None:
    """Call ``work((start, stop), *arguments)`` for all rows, on as many threads as torch has.

    A row's result depends on nothing but its own arguments, so the number of threads
    (``torch.set_num_threads``, ``OMP_NUM_THREADS``) changes none. One thread runs in place, and so
    does a call beside another one that is using the threads.

    Raises:
        Exception: What ``work`` raised, after all threads have ended.
    """
    num_threads = min(_alone or torch.get_num_threads(), num_rows // MIN_ROWS)
    if num_threads <= 1 or not _POOL.lock.acquire(blocking=False):
        work((0, num_rows), *arguments)
        return
    size = max(MIN_ROWS, -(-num_rows // (CHUNKS * num_threads)))
    starts = iter(range(0, num_rows, size))

    def take_chunks() -> None:
        for start in starts:  # one at a time: Python's lock is held
            work((start, min(start + size, num_rows)), *arguments)

    try:
        _POOL.run(take_chunks, num_threads)
    finally:
        _POOL.lock.release()


@contextlib.contextmanager
def torch_on_one_thread() -> Iterator[None]:
    """Leave torch's threads to the kernels: for code of many kernels and small tensor operations.

    After an operation on several threads OpenMP's own keep their cores busy for a while, waiting
    for the next one; a kernel that comes in between has to share them. Stepping a thousand worlds
    on two cores is slower with them than on one.
    """
    global _alone
    if _alone is not None or torch.get_num_threads() == 1:
        yield
        return
    _alone = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(_alone)
        _alone = None


class _Worker(threading.Thread):
    """A thread that waits for work; locks hand it over in a tenth of a future's time."""

    def __init__(self) -> None:
        super().__init__(daemon=True, name="navrl-kernel")
        self._go, self._done = threading.Lock(), threading.Lock()
        self._go.acquire()
        self._done.acquire()
        self._work: Callable | None = None
        self._error: BaseException | None = None
        self.start()

    def run(self) -> None:
        while True:
            self._go.acquire()
            try:
                self._work()
            except BaseException as error:
                self._error = error
            self._done.release()

    def begin(self, work: Callable) -> None:
        self._work = work
        self._go.release()

    def end(self) -> None:
        self._done.acquire()
        error, self._error, self._work = self._error, None, None
        if error is not None:
            raise error


class _Pool:
    """Workers, made when first needed; a forked child inherits none and makes its own."""

    def __init__(self) -> None:
        self._renew()
        if hasattr(os, "register_at_fork"):  # not on Windows
            os.register_at_fork(after_in_child=self._renew)

    def _renew(self) -> None:
        self.lock = threading.Lock()
        self._workers: list[_Worker] = []

    def run(self, work: Callable, num_threads: int) -> None:
        """Call ``work`` in this thread and in others, and wait for all."""
        while len(self._workers) < num_threads - 1:
            self._workers.append(_Worker())
        workers = self._workers[: num_threads - 1]
        with contextlib.ExitStack() as stack:
            for worker in workers:
                worker.begin(work)
                stack.callback(worker.end)
            work()


_POOL = _Pool()
