"""Collectors of experience: protocol and in-process implementation."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from navrl import keys
from navrl.deprecation import renamed_arguments
from navrl.envs.transformed import base_env
from navrl.ops.kernels.threads import torch_on_one_thread
from navrl.training.behavior import Behavior

MakeEnv = Callable[[int], TransformedEnv]
"""Maps a seed to a training environment with its transforms; picklable for workers."""


class Phases:
    """Timer of the phases of the training loop, in seconds by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Add the time spent in the ``with`` block to ``name``."""
        start = time.perf_counter()
        yield
        self.seconds[name] += time.perf_counter() - start


class Collector(Protocol):
    """Interface of a source of experience for the trainer.

    Attributes:
        resumes_episodes: Whether a restored collector continues its episodes. If not, it starts new
            episodes, and pending steps of n-step returns are discarded.
    """

    resumes_episodes: bool

    def start(self, frames: int, max_dynamic: int) -> None:
        """Prepare the collection.

        Args:
            frames: Environment steps of the run so far, for the exploration schedule.
            max_dynamic: Largest number of dynamic pedestrians in new episodes.
        """

    def set_max_dynamic(self, max_dynamic: int) -> None:
        """Set the largest number of dynamic pedestrians in episodes that start from now on."""

    def step(self, frames: int, phases: Phases) -> tuple[int, TensorDictBase]:
        """Return the transitions of one step of ``[M]`` worlds.

        Args:
            frames: Environment steps of the run so far.
            phases: Timer of the collection phases.

        Returns:
            Index of the stream and its transitions. Consecutive steps of a stream come from the
            same worlds, row by row.
        """
        ...

    def state_dict(self) -> dict:
        """Return the entries of a checkpoint."""
        ...

    def load_state_dict(self, state: Mapping) -> None:
        """Restore the entries of :meth:`state_dict`; other entries of ``state`` are ignored."""

    def close(self) -> None:
        """End all processes; repeated calls have no effect."""


class DirectCollector:
    """Collector in the process of the trainer; a resumed run continues bit for bit.

    It is the fastest collector on one machine with few cores, because tensor operations over all
    worlds are faster than several processes, and it always uses the current actor.

    Args:
        make_env: Builds the environment.
        behavior: Behavior policy.
        seed: Seed of the environment.
    """

    resumes_episodes = True

    @renamed_arguments(behaviour="behavior")
    def __init__(self, make_env: MakeEnv, behavior: Behavior, seed: int) -> None:
        self.env, self.behavior = make_env(seed), behavior
        self._carrier: TensorDictBase | None = None

    def start(self, frames: int, max_dynamic: int) -> None:
        """Reset the worlds unless they were restored from a checkpoint."""
        self.set_max_dynamic(max_dynamic)
        if self._carrier is None:
            self._carrier = self.env.reset()

    def set_max_dynamic(self, max_dynamic: int) -> None:
        """Set the largest number of dynamic pedestrians in new episodes."""
        base_env(self.env).max_dynamic = max_dynamic

    def step(self, frames: int, phases: Phases) -> tuple[int, TensorDictBase]:
        """Step every world once."""
        with torch.no_grad():
            with phases("act"):
                self.behavior.act(self._carrier, frames)
            with phases("environment"), torch_on_one_thread():
                stepped, self._carrier = self.env.step_and_maybe_reset(self._carrier)
                begin_episodes(self._carrier, stepped["next", "done"])
        return 0, stepped

    def state_dict(self) -> dict:
        """Return the state of every world and the last observation."""
        return {
            "environment": base_env(self.env).episode_state(),
            "carrier": self._carrier.to_dict(),
        }

    def load_state_dict(self, state: Mapping) -> None:
        """Restore every world and the last observation."""
        self.env.reset()
        base_env(self.env).load_episode_state(state["environment"])
        carrier = TensorDict(state["carrier"], self.env.batch_size)
        self._carrier = carrier.to(self.env.device)

    def close(self) -> None:
        """Close the simulator."""
        self.env.close(raise_if_closed=False)


def begin_episodes(carrier: TensorDictBase, was_reset: Tensor) -> None:
    """Set the last action and noise ``[N, C]`` to NaN where ``was_reset [N, 1]``.

    A new episode begins at rest, with noise of its own.
    """
    for key in (keys.ACTION, keys.EXPLORATION_NOISE):
        last = carrier.get(key, None)
        if last is not None:
            carrier.set(key, last.masked_fill(was_reset, torch.nan))
