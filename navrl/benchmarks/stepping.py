"""Speed of complete steps, from simulation to reward, including resets."""

from __future__ import annotations

import contextlib
import gc
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import torch
from torchrl.envs import TransformedEnv

from navrl import keys
from navrl.benchmarks.measurement import Budget, Task, alternate
from navrl.benchmarks.results import Bar, Row, Series
from navrl.ops.kernels.threads import torch_on_one_thread

MakeEnv = Callable[[int], TransformedEnv]
"""Maps a number of worlds to an environment with all of its transforms."""

_NUM_ACTIONS = 64  # drawn in advance and reused, so that drawing is not measured


class RandomDrive:
    """Steps of an environment with random actions; worlds are reset when an episode ends.

    Args:
        env: Environment with its transforms and actions in [-1, 1].
    """

    def __init__(self, env: TransformedEnv) -> None:
        self.env = env
        generator = torch.Generator().manual_seed(0)
        shape = (_NUM_ACTIONS, *env.batch_size, 2)
        self._actions = (torch.rand(shape, generator=generator) * 2 - 1).to(env.device)
        self.carrier, self._count = env.reset(), 0

    @torch.no_grad()
    def __call__(self) -> int:
        """Step all worlds once; return the number of worlds."""
        self.carrier.set(keys.ACTION, self._actions[self._count % _NUM_ACTIONS])
        self._count += 1
        with torch_on_one_thread():  # as in training and evaluation
            _, self.carrier = self.env.step_and_maybe_reset(self.carrier)
        return self.env.batch_size.numel()


def step_rows(
    make: MakeEnv,
    make_reference: MakeEnv,
    num_worlds: int,
    num_reference_worlds: int,
    budget: Budget,
    cores: int,
) -> list[Row]:
    """Measure complete steps on one and two cores against the same pipeline on PyBullet.

    Two cores are used in two ways: by two processes, as with ``collector=process``, and by two
    threads of the kernels, while the code between kernels runs on one thread.

    Args:
        make: Builds the environment with the batched simulator.
        make_reference: Builds the environment with the PyBullet simulator.
        num_worlds: Worlds of the batched simulator.
        num_reference_worlds: Worlds of the PyBullet simulator.
        budget: Duration and number of measurements.
        cores: Number of cores of the machine.
    """
    env, reference = make(num_worlds), make_reference(num_reference_worlds)
    drive = RandomDrive(env)
    tasks = {"one": Task(drive), "bullet": Task(RandomDrive(reference))}
    with contextlib.ExitStack() as stack:
        stack.callback(env.close)
        stack.callback(reference.close)
        if cores > 1:
            tasks["threads"] = Task(drive, 2)
            tasks["processes"] = Task(stack.enter_context(StepWorkers(make, num_worlds, 2)))
        rates = alternate(tasks, budget)
    one, bullet = rates["one"], rates["bullet"]
    label = f"complete steps, {num_worlds} worlds, 1 core"
    return [
        Row("step.one_core", label, "/s", one, Bar(15_000)),
        *(_two_core_rows(rates) if cores > 1 else []),
        Row("step.bullet", "… on PyBullet", "/s", bullet),
        Row("step.ratio", "… 1 core / PyBullet", "x", one / bullet, Bar(40.0)),
    ]


def _two_core_rows(rates: Mapping[str, np.ndarray]) -> list[Row]:
    one, threads, processes = (rates[name] for name in ("one", "threads", "processes"))
    return [
        Row("step.two_cores", "… 2 cores, a process each", "/s", processes),
        Row("step.speedup", "… 2 processes / 1 core", "x", processes / one, Bar(1.7)),
        Row("step.threads", "… 2 threads / 1 core", "x", threads / one),
    ]


class StepWorkers:
    """Processes that step separate worlds on one thread each, like the workers of a training.

    Args:
        make: Builds an environment; must be picklable.
        num_worlds: Worlds of each process.
        count: Number of processes.
    """

    _STEPS = 10  # steps of a process between two synchronizations

    def __init__(self, make: MakeEnv, num_worlds: int, count: int) -> None:
        context = get_context("spawn")
        self._pools = [
            ProcessPoolExecutor(1, context, _start_worker, (make, num_worlds)) for _ in range(count)
        ]

    def __call__(self) -> int:
        """Step all worlds a few times; return the number of steps."""
        futures = [pool.submit(_step_worker, self._STEPS) for pool in self._pools]
        return sum(future.result() for future in futures)

    def __enter__(self) -> StepWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        for pool in self._pools:
            pool.shutdown()


_worker_drive: RandomDrive | None = None


def _start_worker(make: MakeEnv, num_worlds: int) -> None:
    global _worker_drive
    torch.set_num_threads(1)
    _worker_drive = RandomDrive(make(num_worlds))
    gc.collect()
    gc.freeze()


def _step_worker(count: int) -> int:
    return sum(_worker_drive() for _ in range(count))


def worlds_series(make: MakeEnv, worlds: Sequence[int], budget: Budget) -> Series:
    """Measure the growth of the time of a batch of complete steps with the number of worlds."""
    envs = {n: make(n) for n in worlds}
    rates = alternate({str(n): Task(RandomDrive(env)) for n, env in envs.items()}, budget)
    for env in envs.values():
        env.close()
    costs = np.stack([1e3 * n / rates[str(n)] for n in worlds], axis=-1)
    return Series("worlds", "a complete step of all worlds", "worlds", "ms", worlds, costs)


def threads_series(
    make: MakeEnv, num_worlds: int, threads: Sequence[int], budget: Budget
) -> Series:
    """Measure the time of complete steps as a function of the number of threads."""
    drive = RandomDrive(make(num_worlds))
    rates = alternate({str(n): Task(drive, n) for n in threads}, budget)
    drive.env.close()
    costs = np.stack([1e3 * num_worlds / rates[str(n)] for n in threads], axis=-1)
    label = f"a complete step of {num_worlds} worlds"
    return Series("threads", label, "threads", "ms", threads, costs)
