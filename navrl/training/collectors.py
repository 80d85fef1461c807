"""Where experience comes from: worlds in this process, or workers that send theirs."""

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
from navrl.ops.kernels.threads import torch_on_one_thread
from navrl.training.behaviour import Behaviour

MakeEnv = Callable[[int], TransformedEnv]
"""From a seed to a training environment with its transforms; must pickle for workers."""


class Phases:
    """Seconds spent in each named part of the training loop."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Add the time spent in the ``with`` block to ``name``."""
        start = time.perf_counter()
        yield
        self.seconds[name] += time.perf_counter() - start


class Collector(Protocol):
    """What the trainer needs of a source of experience.

    Attributes:
        resumes_episodes: Whether a restored collector goes on in the middle of its episodes.
            If not, it starts new ones, and steps held back for n-step returns are void.
    """

    resumes_episodes: bool

    def start(self, frames: int, max_dynamic: int) -> None:
        """Get ready to collect.

        Args:
            frames: Environment steps of the run so far; they drive the exploration's schedule.
            max_dynamic: Dynamic pedestrians that new episodes have at most.
        """

    def set_max_dynamic(self, max_dynamic: int) -> None:
        """Tell the curriculum's level; it holds for episodes that start from now on."""

    def step(self, frames: int, phases: Phases) -> tuple[int, TensorDictBase]:
        """Return what one step of ``[M]`` worlds gave.

        Args:
            frames: Environment steps of the run so far.
            phases: Where the time it takes is booked.

        Returns:
            Number of the stream and its transitions: consecutive steps of one stream come from the
            same worlds, row by row.
        """

    def state_dict(self) -> dict:
        """Return what a checkpoint must hold."""

    def load_state_dict(self, state: Mapping) -> None:
        """Restore what :meth:`state_dict` returned; other entries of ``state`` are ignored."""

    def close(self) -> None:
        """End all processes; may be called twice."""


class DirectCollector:
    """Step the worlds in the trainer's own process; a resumed run goes on bit for bit.

    The fastest choice on one machine with few cores: no process beats one tensor operation over
    all worlds, and the actor is always the newest.

    Args:
        make_env: Builds the environment.
        behaviour: What acts.
        seed: Of the environment.
    """

    resumes_episodes = True

    def __init__(self, make_env: MakeEnv, behaviour: Behaviour, seed: int) -> None:
        self.env, self.behaviour = make_env(seed), behaviour
        self._carrier: TensorDictBase | None = None

    def start(self, frames: int, max_dynamic: int) -> None:
        """Reset the worlds unless a checkpoint has set them."""
        self.set_max_dynamic(max_dynamic)
        if self._carrier is None:
            self._carrier = self.env.reset()

    def set_max_dynamic(self, max_dynamic: int) -> None:
        """Let new episodes have at most this many dynamic pedestrians."""
        self.env.base_env.max_dynamic = max_dynamic

    def step(self, frames: int, phases: Phases) -> tuple[int, TensorDictBase]:
        """Act in every world once."""
        with torch.no_grad():
            with phases("act"):
                self.behaviour.act(self._carrier, frames)
            with phases("environment"), torch_on_one_thread():
                stepped, self._carrier = self.env.step_and_maybe_reset(self._carrier)
                forget_last_action(self._carrier, stepped["next", "done"])
        return 0, stepped

    def state_dict(self) -> dict:
        """Return every world and what was observed last."""
        return {
            "environment": self.env.base_env.episode_state(),
            "carrier": self._carrier.to_dict(),
        }

    def load_state_dict(self, state: Mapping) -> None:
        """Put every world back where it was."""
        self.env.reset()
        self.env.base_env.load_episode_state(state["environment"])
        carrier = TensorDict(state["carrier"], self.env.batch_size)
        self._carrier = carrier.to(self.env.device)

    def close(self) -> None:
        """Close the simulator."""
        self.env.close(raise_if_closed=False)


def forget_last_action(carrier: TensorDictBase, was_reset: Tensor) -> None:
    """Set ``action [N, 2]`` to NaN where ``was_reset [N, 1]``: a new episode begins at rest."""
    carrier.set(keys.ACTION, carrier.get(keys.ACTION).masked_fill(was_reset, torch.nan))
