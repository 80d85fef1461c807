"""Rows are shared among threads: each is worked on once, and errors and forks do no harm."""

import multiprocessing
import threading

import numpy as np
import pytest
import torch

from navrl.ops.kernels.threads import MIN_ROWS, run_rows, torch_on_one_thread


@pytest.fixture
def num_threads():
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("rows", [0, 1, MIN_ROWS, 2 * MIN_ROWS, 3 * MIN_ROWS + 1, 1000])
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_every_row_is_processed_once(num_threads, rows, threads):
    num_threads(threads)
    visits, workers = np.zeros(rows, dtype=int), set()

    def work(share, visits):
        visits[share[0] : share[1]] += 1
        workers.add(threading.get_ident())

    run_rows(work, rows, (visits,))
    assert (visits == 1).all()
    assert len(workers) <= max(1, min(threads, rows // MIN_ROWS))


def test_threads_run_concurrently(num_threads):
    num_threads(2)
    meeting, workers = threading.Barrier(2), set()

    def work(share):
        if threading.get_ident() not in workers:  # each one's first rows wait for the other's
            workers.add(threading.get_ident())
            meeting.wait(timeout=10)

    run_rows(work, 64, ())
    assert len(workers) == 2


def test_an_error_in_any_thread_is_raised(num_threads):
    num_threads(2)

    def work(share):
        raise ZeroDivisionError(f"row {share[0]}")

    with pytest.raises(ZeroDivisionError, match="row"):
        run_rows(work, 64, ())


def _double(values):
    run_rows(lambda share: values.__setitem__(slice(*share), 2.0), len(values), ())


def _double_in_child(connection):
    values = np.ones(64)
    _double(values)
    connection.send(values.sum())


def test_forked_child_has_its_own_threads(num_threads):
    num_threads(2)
    _double(np.ones(64))  # the parent's threads exist
    ours, theirs = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=_double_in_child, args=(theirs,))
    child.start()
    assert ours.poll(30), "the child hangs"
    assert ours.recv() == 128.0
    child.join()


def test_kernels_use_the_threads_of_torch(num_threads):
    num_threads(2)
    workers = set()
    with torch_on_one_thread(), torch_on_one_thread():
        assert torch.get_num_threads() == 1
        meeting = threading.Barrier(2)

        def work(share):
            if threading.get_ident() not in workers:
                workers.add(threading.get_ident())
                meeting.wait(timeout=10)

        run_rows(work, 64, ())
    assert len(workers) == 2
    assert torch.get_num_threads() == 2


def test_concurrent_launch_runs_in_the_calling_thread(num_threads):
    """Two Python threads may both launch; who comes second does the work alone."""
    num_threads(2)
    begun, finish, seen = threading.Event(), threading.Event(), []

    def wait(share):
        begun.set()
        finish.wait(timeout=10)

    first = threading.Thread(target=run_rows, args=(wait, 64, ()))
    first.start()
    begun.wait(timeout=10)
    run_rows(seen.append, 64, ())
    finish.set()
    first.join(timeout=10)
    assert seen == [(0, 64)]
