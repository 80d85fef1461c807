"""What a command sets in its process: threads, and the log of TorchRL."""

import logging
import os

import pytest
from torchrl._utils import logger as torchrl_log

from navrl import factory
from navrl.config import compose
from navrl.factory import environment


@pytest.fixture
def machine(monkeypatch):
    """Set cores, load, affinity and OMP_NUM_THREADS; returns the default number of threads."""

    def threads(cores, load, usable=None, limit=None):
        monkeypatch.setattr(os, "cpu_count", lambda: cores)
        monkeypatch.setattr(os, "getloadavg", lambda: (load, 0.0, 0.0))
        monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(usable or cores)))
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
        if limit is not None:
            monkeypatch.setenv("OMP_NUM_THREADS", limit)
        environment.free_cores.cache_clear()
        return environment.num_threads(compose("evaluate"))

    yield threads
    environment.free_cores.cache_clear()


@pytest.mark.parametrize(
    "cores, load, usable, limit, threads",
    [
        (8, 0.0, None, None, 8),
        (8, 2.6, None, None, 5),
        (2, 20.0, None, None, 1),
        (8, 0.0, 3, None, 3),
        (8, 0.0, None, "2", 2),
        (8, 7.9, None, "4", 1),
        (8, 0.0, None, "many", 8),
    ],
)
def test_default_threads_are_the_idle_cores(machine, cores, load, usable, limit, threads):
    assert machine(cores, load, usable, limit) == threads


def test_default_threads_do_not_change_with_own_load(machine, monkeypatch):
    assert machine(8, 0.0) == 8
    monkeypatch.setattr(os, "getloadavg", lambda: (8.0, 0.0, 0.0))
    assert environment.num_threads(compose("evaluate")) == 8
    assert environment.num_threads(compose("evaluate", ["num_threads=3"])) == 3


def test_torchrl_log_has_no_colors(caplog, capfd, monkeypatch):
    monkeypatch.setattr(torchrl_log, "handlers", [logging.StreamHandler()])
    monkeypatch.setattr(torchrl_log, "propagate", False)
    monkeypatch.delenv("RL_LOGGING_LEVEL", raising=False)
    factory.set_threads(compose("evaluate", ["num_threads=1"]))
    torchrl_log.info("Initialized a storage")
    torchrl_log.warning("a warning")
    assert caplog.messages == ["a warning"]
    assert "\033" not in "".join(capfd.readouterr())
    assert torchrl_log.propagate and not torchrl_log.handlers
