"""Thread pool that distributes the rows of a kernel, which releases the GIL.

Numba's parallel loops are not used: with two threads a scan took twice as long as the serial loop,
and their thread pools either do not survive a fork or abort the process when two Python threads
launch kernels at the same time.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterator

import torch

MIN_ROWS = 8  # rows per thread; the hand-over of fewer takes longer than their computation
CHUNKS = 8  # chunks per thread, for load balancing between rows and cores of different speed

_num_kernel_threads: int | None = None  # number of kernel threads while torch is limited to one


def run_rows(work: Callable, num_rows: int, arguments: tuple) -> None:
    """Call ``work((start, stop), *arguments)`` for all rows, on as many threads as torch uses.

    The result of a row depends only on its own arguments, so the number of threads
    (``torch.set_num_threads``, ``OMP_NUM_THREADS``) does not change it. The call runs in the
    calling thread if only one thread is available or another call is using the pool.

    Raises:
        Exception: If ``work`` raised it; raised again after all threads have ended.
    """
    num_threads = min(_num_kernel_threads or torch.get_num_threads(), num_rows // MIN_ROWS)
    if num_threads <= 1 or not _POOL.lock.acquire(blocking=False):
        work((0, num_rows), *arguments)
        return
    size = max(MIN_ROWS, -(-num_rows // (CHUNKS * num_threads)))
    starts = iter(range(0, num_rows, size))

    def take_chunks() -> None:
        for start in starts:  # the iterator is safe: the GIL is held here
            work((start, min(start + size, num_rows)), *arguments)

    try:
        _POOL.run(take_chunks, num_threads)
    finally:
        _POOL.lock.release()


@contextlib.contextmanager
def torch_on_one_thread() -> Iterator[None]:
    """Limit torch to one thread while kernels use all: for many kernels and small tensors.

    After a parallel operation the OpenMP threads spin for a while and wait for the next one, and a
    kernel that starts in between competes with them. Without this limit, stepping a thousand worlds
    is slower on two cores than on one.
    """
    global _num_kernel_threads
    if _num_kernel_threads is not None or torch.get_num_threads() == 1:
        yield
        return
    _num_kernel_threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(_num_kernel_threads)
        _num_kernel_threads = None


class _Worker(threading.Thread):
    """Worker thread; locks hand over work in a tenth of the time of a future."""

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
                work = self._work
                if work is not None:
                    work()
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
    """Pool of worker threads, created on demand; a forked child creates its own."""

    def __init__(self) -> None:
        self._create_worker()
        if hasattr(os, "register_at_fork"):  # not on Windows
            os.register_at_fork(after_in_child=self._create_worker)

    def _create_worker(self) -> None:
        self.lock = threading.Lock()
        self._workers: list[_Worker] = []

    def run(self, work: Callable, num_threads: int) -> None:
        """Call ``work`` in this thread and in ``num_threads - 1`` workers, and wait for all."""
        while len(self._workers) < num_threads - 1:
            self._workers.append(_Worker())
        workers = self._workers[: num_threads - 1]
        with contextlib.ExitStack() as stack:
            for worker in workers:
                worker.begin(work)
                stack.callback(worker.end)
            work()


_POOL = _Pool()
