"""Parts of a worker process: environment, behavior policy and batches."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import Collector as TorchRLCollector
from torchrl.envs import InitTracker, Transform, TransformedEnv

from navrl import keys
from navrl.deprecation import renamed_arguments
from navrl.training.behavior import Behavior
from navrl.training.collectors import begin_episodes
from navrl.training.replay import Compact

_IS_INIT = "is_init"  # [N, 1] bool: the first step of an episode


class WorkerPolicy(TensorDictModuleBase):
    """Picklable behavior policy.

    The frame count, which determines the exploration schedule, and the curriculum level are buffers
    of the module, so they are transferred to workers together with the weights of the actor.

    Args:
        behavior: Behavior policy; copied, so that it is independent of the learner's actor. The
            copy is on the CPU, where workers act, independent of the device of the learner.
    """

    frames: Tensor
    max_dynamic: Tensor

    @renamed_arguments(behaviour="behavior")
    def __init__(self, behavior: Behavior) -> None:
        super().__init__()
        self._source = [behavior.actor]  # in a list, so that it is not registered as a submodule
        self.behavior = deepcopy(behavior)
        self.actor = self.behavior.actor.requires_grad_(False).cpu()
        self.in_keys, self.out_keys = [*self.actor.in_keys], [keys.ACTION, keys.MAX_DYNAMIC]
        self.out_keys += getattr(behavior.exploration, "state_keys", ())  # carried between steps
        self.register_buffer("frames", torch.zeros((), dtype=torch.int64))
        self.register_buffer("max_dynamic", torch.zeros((), dtype=torch.int64))

    def __getstate__(self) -> dict:
        """Exclude the learner's actor from the pickle."""
        return {**self.__dict__, "_source": []}

    @torch.no_grad()
    def refresh(self, frames: int, max_dynamic: int) -> TensorDictBase:
        """Copy weights and counters of the learner; return the tensors to send to workers."""
        fresh = TensorDict.from_module(self._source[0]).data
        TensorDict.from_module(self.actor).data.update_(fresh)
        self.frames.fill_(frames)
        self.max_dynamic.fill_(max_dynamic)
        return TensorDict.from_module(self).data

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, and the level for the environment to take."""
        last = tensordict.get(keys.ACTION, None)
        if last is not None:  # of the episode before, or zeros that the collector begins with
            begin_episodes(tensordict, tensordict.get(_IS_INIT))
        level = self.max_dynamic.expand(*tensordict.batch_size, 1)
        tensordict.set(keys.MAX_DYNAMIC, level.clone())
        return self.behavior.act(tensordict, int(self.frames))


class CurriculumLevel(Transform):
    """Transform that sets the curriculum level of the environment to that of the policy."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        level = tensordict.get(keys.MAX_DYNAMIC, None)
        if level is not None:
            self.parent.base_env.max_dynamic = int(level.reshape(-1)[0])
        return tensordict


def worker_seed(seed: int, worker: int, frames: int = 0) -> int:
    """Return the seed of a worker, a function of the seed of the run.

    Args:
        seed: Seed of the run.
        worker: Index of the worker.
        frames: Frames at its start, so that a resumed run does not repeat its first episodes.
    """
    return int(np.random.SeedSequence([seed, worker, frames]).generate_state(1)[0]) >> 1


@dataclass(frozen=True)
class WorkerEnv:
    """Picklable constructor of the environment of a worker, called in its process.

    Args:
        make_env: Maps a seed to an environment.
        seed: Seed of the worker.
        num_threads: CPU threads of the worker.
        max_dynamic: Largest number of dynamic pedestrians in its first episodes.
    """

    make_env: Callable[[int], TransformedEnv]
    seed: int
    num_threads: int
    max_dynamic: int

    def __call__(self) -> TransformedEnv:
        """Set threads and seed of the process, then build the environment."""
        torch.set_num_threads(self.num_threads)
        torch.set_flush_denormal(True)
        torch.manual_seed(self.seed)  # exploration samples from the global generator
        env = self.make_env(self.seed)
        env.base_env.max_dynamic = self.max_dynamic
        env.append_transform(CurriculumLevel())
        env.append_transform(InitTracker(init_key=_IS_INIT))
        return env


@dataclass(frozen=True)
class WorkerBatch:
    """Reduce a batch to the entries that the learner needs.

    Args:
        compact: Reduction of transitions.
        worker: Index of the worker, written into every transition.
    """

    compact: Compact
    worker: int

    def __call__(self, batch: TensorDictBase) -> TensorDict:
        """Return ``[N, T]`` reduced transitions with outcome, curriculum level and worker."""
        small = self.compact(batch)
        for key in (keys.OUTCOME, keys.REWARD_TERMS):
            small["next", key] = batch["next", key]
        small[keys.MAX_DYNAMIC] = batch[keys.MAX_DYNAMIC]
        small[keys.WORKER] = torch.full((*batch.batch_size, 1), self.worker)
        if "collector" in batch:  # metadata of TorchRL
            small["collector"] = batch["collector"]
        return small


class WorkerCollector:
    """Replacement of TorchRL's collector class in engines without a per-worker postproc hook.

    Args:
        compact: Reduction of transitions.
    """

    def __init__(self, compact: Compact) -> None:
        self.compact = compact

    def __call__(self, *args: Any, worker_idx: int, **kwargs: Any) -> TorchRLCollector:
        """Build the collector of one worker process."""
        kwargs["postproc"] = WorkerBatch(self.compact, worker_idx)
        return TorchRLCollector(*args, worker_idx=worker_idx, **kwargs)
