"""Base class of collectors with worker processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from tensordict import TensorDictBase
from torchrl.collectors import BaseCollector

from navrl import keys
from navrl.deprecation import renamed_arguments
from navrl.training.behavior import Behavior
from navrl.training.collectors import MakeEnv, Phases
from navrl.training.interruption import shielded_children
from navrl.training.replay import Compact
from navrl.training.worker import WorkerEnv, WorkerPolicy, worker_seed


class WorkersCollector(ABC):
    """Base class of collectors with worker processes, each with its own worlds and policy copy.

    Subclasses select the TorchRL collector that runs the workers. Workers send only the entries
    that learning needs. The policy of a worker is older than that of the learner by up to
    ``push_every_batches`` of its batches, which off-policy learning allows.

    A resumed run restores learner, replay and counters exactly; workers start new episodes.

    Args:
        make_env: Builds the environment of a worker from a seed; must be picklable.
        behavior: Behavior policy with the actor in training.
        seed: Seed of the run; that of worker k is a hash of it, k and the frames at its start.
        num_worlds: Worlds of each worker.
        num_workers: Number of worker processes.
        steps_per_batch: Steps of every world in a batch.
        push_every_batches: Batches of a worker between two updates of its weights.
        sync: Whether workers wait for each other and for the learner; reproducible, but slower.
        threads_per_worker: CPU threads of each worker.
        storage: ``"float16"`` or ``"float32"`` for transferred observations.

    Raises:
        ValueError: If a count is not positive or ``storage`` is unknown.
    """

    resumes_episodes = False

    @renamed_arguments(behaviour="behavior")
    def __init__(
        self,
        make_env: MakeEnv,
        behavior: Behavior,
        seed: int,
        num_worlds: int,
        num_workers: int = 2,
        steps_per_batch: int = 8,
        push_every_batches: int = 1,
        sync: bool = False,
        threads_per_worker: int = 1,
        storage: str = "float16",
    ) -> None:
        counts = {
            "num_worlds": num_worlds,
            "num_workers": num_workers,
            "steps_per_batch": steps_per_batch,
            "push_every_batches": push_every_batches,
            "threads_per_worker": threads_per_worker,
        }
        for name, value in counts.items():
            if value < 1:
                raise ValueError(f"{name}={value}: must be >= 1")
        self.make_env, self.seed = make_env, seed
        self.num_worlds, self.num_workers = num_worlds, num_workers
        self.steps_per_batch, self.push_every_batches = steps_per_batch, push_every_batches
        self.sync, self.threads_per_worker = sync, threads_per_worker
        self.compact = Compact(behavior.actor.in_keys, storage)
        self.policy = WorkerPolicy(behavior)
        self.max_dynamic = 0
        self._workers: BaseCollector | None = None
        self._batches: Iterator[TensorDictBase] | None = None
        self._steps: deque[tuple[int, TensorDictBase]] = deque()
        self._received: Counter[int] = Counter()
        self._due: set[int] = set()  # workers whose weights must be updated

    @abstractmethod
    def _launch(self, envs: list[WorkerEnv]) -> BaseCollector:
        """Start the workers, each with one of ``envs`` and a copy of ``self.policy``."""

    @property
    def frames_per_batch(self) -> int:
        """Frames per batch of TorchRL's collector: of one worker, or of all if ``sync``."""
        return self.num_worlds * self.steps_per_batch * (self.num_workers if self.sync else 1)

    def start(self, frames: int, max_dynamic: int) -> None:
        """Start the processes with the current weights of the learner."""
        self.max_dynamic = max_dynamic
        self.policy.refresh(frames, max_dynamic)
        seeds = [worker_seed(self.seed, k, frames) for k in range(self.num_workers)]
        envs = [
            WorkerEnv(self.make_env, seed, self.threads_per_worker, max_dynamic) for seed in seeds
        ]
        with _isolated_state(), shielded_children():
            workers = self._workers = self._launch(envs)
        self._push(frames, None)
        self._batches = iter(workers)

    def set_max_dynamic(self, max_dynamic: int) -> None:
        """Set the level, which each worker receives with the next weights."""
        self.max_dynamic = max_dynamic

    def step(self, frames: int, phases: Phases) -> tuple[int, TensorDictBase]:
        """Return the next step of any worker; wait for a batch if none is available."""
        while not self._steps:
            if self._due:
                with phases("push"):
                    self._push(frames, None if self.sync else sorted(self._due))
                self._due.clear()
            with phases("wait"):
                self._take(self._next())
        return self._steps.popleft()

    def _next(self) -> TensorDictBase:
        try:
            assert self._batches is not None  # see start
            return next(self._batches)
        except Exception as error:  # each engine has its own
            raise RuntimeError(
                "a worker has died or failed; resume=<run folder> continues from the checkpoint"
            ) from error

    def _take(self, batch: TensorDictBase) -> None:
        """Split a batch ``[N, T]`` of one worker or ``[W, N, T]`` of all workers into steps."""
        for part in batch.unbind(0) if batch.ndim == 3 else (batch,):
            worker = int(part.get(keys.WORKER).flatten()[0])
            self._steps.extend((worker, step) for step in part.unbind(1))
            self._received[worker] += 1
            if self._received[worker] % self.push_every_batches == 0:
                self._due.add(worker)

    def _push(self, frames: int, workers: list[int] | None) -> None:
        """Send the newest weights to some workers, or to all."""
        assert self._workers is not None  # see start
        weights = self.policy.refresh(frames, self.max_dynamic)
        self._workers.update_policy_weights_(weights, worker_ids=workers)

    def state_dict(self) -> dict:
        """Return an empty state, because episodes of workers are not saved."""
        return {}

    def load_state_dict(self, state: Mapping) -> None:
        """Ignore the state; see :meth:`state_dict`."""
        return None

    def close(self) -> None:
        """End the workers."""
        workers, self._workers, self._batches = self._workers, None, None
        if workers is not None:
            with _isolated_state():
                workers.shutdown()


@contextmanager
def _isolated_state() -> Iterator[None]:
    """Restore threads and random state of the learner, which TorchRL's collectors change."""
    threads = torch.get_num_threads()
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        torch.set_num_threads(threads)
