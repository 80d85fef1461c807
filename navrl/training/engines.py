"""Worker collectors on TorchRL's engines: processes, Ray and torch.distributed."""

from __future__ import annotations

import importlib.util
import os
import socket
import sys
from collections.abc import Mapping
from typing import Any

import torch
from torchrl.collectors import BaseCollector, MultiAsyncCollector, MultiSyncCollector

from navrl.extras import install_hint
from navrl.training.replay import Compact
from navrl.training.worker import WorkerBatch, WorkerCollector, WorkerEnv
from navrl.training.workers import WorkersCollector

_UNLIMITED = sys.maxsize  # frames; TorchRL's collectors stop at a total count


class ProcessCollector(WorkersCollector):
    """Collector with worker processes on this machine; weights and batches in shared memory.

    Unless ``sync``, the weights of a worker may change between two steps, or during a step, in
    which case it uses a mix of old and new weights; the effect is far smaller than exploration
    noise.
    """

    def _launch(self, envs: list[WorkerEnv]) -> BaseCollector:
        kind = MultiSyncCollector if self.sync else MultiAsyncCollector
        self.policy.share_memory()
        return kind(
            envs,
            self.policy,
            frames_per_batch=self.frames_per_batch,
            collector_class=WorkerCollector(self.compact),
            num_threads=torch.get_num_threads(),
            num_sub_threads=self.threads_per_worker,
            use_buffers=False,  # small batches are new tensors
            trust_policy=True,
        )

    def _push(self, frames: int, workers: list[int] | None) -> None:
        # Workers read the same memory. TorchRL's push would wait up to 0.1 s for an acknowledgment
        # of each worker, and indefinitely for a dead worker.
        self.policy.refresh(frames, self.max_dynamic)


class RayCollector(WorkersCollector):
    """Collector with Ray actors as workers, on this machine or in a Ray cluster.

    Args:
        address: Address of a running cluster, ``"auto"`` for that of this machine; ``None`` starts
            Ray on this machine only.
        kwargs: See :class:`WorkersCollector`.

    Raises:
        ValueError: If Ray is not installed.
    """

    def __init__(self, *args: Any, address: str | None = None, **kwargs: Any) -> None:
        _require("ray", "collector=ray", "ray")
        super().__init__(*args, **kwargs)
        self.address = address

    def _launch(self, envs: list[WorkerEnv]) -> BaseCollector:
        from torchrl.collectors.distributed import RayCollector as TorchRLRayCollector

        return TorchRLRayCollector(
            envs,
            self.policy,
            frames_per_batch=self.frames_per_batch,
            total_frames=_UNLIMITED,
            sync=self.sync,
            trust_policy=True,
            ray_init_config=self._ray_config(),
            remote_configs={"num_cpus": self.threads_per_worker, "num_gpus": 0},
            collector_kwargs=_collector_kwargs(self.compact, self.num_workers),
        )

    def _ray_config(self) -> dict:
        if self.address is not None:
            return {"address": self.address, "log_to_driver": False}
        path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        return {
            "num_cpus": self.num_workers * self.threads_per_worker,
            "include_dashboard": False,
            "log_to_driver": False,
            "runtime_env": {"env_vars": {"PYTHONPATH": path}},  # so that workers find user modules
        }


class DistributedCollector(WorkersCollector):
    """Collector with workers that communicate by torch.distributed over TCP.

    Args:
        launcher: ``"mp"`` for processes on this machine, ``"submitit"`` for SLURM jobs.
        backend: Backend of torch.distributed; ``"gloo"`` for CPUs.
        port: TCP port of the learner; the next two ports are used too; ``None`` for a free one.
        slurm: Options of submitit's executor, e.g. ``{"slurm_partition": "cpu"}``.
        kwargs: See :class:`WorkersCollector`.

    Raises:
        ValueError: If the launcher is unknown, or submitit is needed and not installed.
    """

    def __init__(
        self,
        *args: Any,
        launcher: str = "mp",
        backend: str = "gloo",
        port: int | None = None,
        slurm: Mapping[str, object] | None = None,
        **kwargs: Any,
    ) -> None:
        if launcher not in ("mp", "submitit"):
            raise ValueError(f"launcher={launcher!r}: must be one of ['mp', 'submitit']")
        if launcher == "submitit":
            _require("submitit", "launcher=submitit", "launchers")
        super().__init__(*args, **kwargs)
        self.launcher, self.backend, self.port = launcher, backend, port
        self.slurm = dict(slurm or {})

    def _launch(self, envs: list[WorkerEnv]) -> BaseCollector:
        from torchrl.collectors.distributed import DistributedCollector as TorchRLDistributed

        return TorchRLDistributed(
            envs,
            self.policy,
            frames_per_batch=self.frames_per_batch,
            total_frames=_UNLIMITED,
            sync=self.sync,
            backend=self.backend,
            launcher=self.launcher,
            tcp_port=_free_port() if self.port is None else self.port,
            slurm_kwargs=self.slurm,
            collector_kwargs=_collector_kwargs(self.compact, self.num_workers),
        )


def _collector_kwargs(compact: Compact, num_workers: int) -> list[dict]:
    return [{"postproc": WorkerBatch(compact, k)} for k in range(num_workers)]


def _require(module: str, choice: str, extra: str) -> None:
    found = importlib.util.find_spec(module)
    if found is None or found.origin is None:  # a folder of that name, e.g. /tmp/ray, has no origin
        raise ValueError(f"{choice}: needs {module}, which is not installed; {install_hint(extra)}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]
