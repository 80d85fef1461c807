"""Rollouts for on-policy algorithms, with the interface of the replay buffer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase

from navrl.checks import check_counts
from navrl.ops.backend import find_device
from navrl.training.replay import Compact


class Rollouts:
    """Collect T steps of all worlds, then return them in order and begin the next rollout.

    With ``schedule.frames_per_update`` = T times the number of worlds an algorithm has one update
    per rollout. It is empty until a rollout is complete.

    Args:
        observation_keys: Keys that the networks read.
        num_steps: Steps T of each world in a rollout.
        device: Device of the rollouts.

    Raises:
        ValueError: If ``num_steps`` is not positive.
    """

    def __init__(
        self,
        observation_keys: Sequence[str],
        num_steps: int = 64,
        device: torch.device | str = "cpu",
    ) -> None:
        """Begin an empty rollout."""
        check_counts(num_steps=num_steps)
        self.num_steps, self.device = num_steps, find_device(device)
        self._compact = Compact(observation_keys, "float32")
        self._steps: list[TensorDictBase] = []

    def __len__(self) -> int:
        is_complete = len(self._steps) == self.num_steps
        return sum(step.numel() for step in self._steps) if is_complete else 0

    def extend(self, transitions: TensorDictBase, stream: int = 0) -> None:
        """Add one step of ``[N]`` worlds; after a complete rollout a new one begins.

        Raises:
            ValueError: If there are several streams, which belong to different policies.
        """
        if stream != 0:
            raise ValueError(
                "replay=rollouts: needs one stream of experience; set collector=direct"
            )
        if len(self._steps) == self.num_steps:
            self._steps = []
        self._steps.append(self._compact(transitions).to(self.device))

    def sample(self, count: int = 1) -> TensorDictBase:
        """Return the rollout ``[count, N, T]``, repeated for ``count`` > 1."""
        rollout = cast(TensorDict, TensorDict.stack(self._steps, 1))
        return rollout.expand(count, *rollout.batch_size).clone()

    def discard_pending(self) -> None:
        """Discard an incomplete rollout whose episodes are not continued."""
        self._steps = []

    def save(self, folder: Path) -> dict[str, object]:
        """Return the state for :meth:`load`; no file is written to ``folder``."""
        shapes = [step.batch_size for step in self._steps]
        steps = [step.flatten_keys(".").to_dict() for step in self._steps]
        return {"steps": steps, "num_worlds": [shape.numel() for shape in shapes]}

    def prune(self, folder: Path) -> None:
        """Do nothing: no file is written."""

    def load(self, folder: Path, state: Mapping[str, Any]) -> None:
        """Restore the steps of :meth:`save`."""
        self._steps = [
            TensorDict(step, [count]).unflatten_keys(".").to(self.device)
            for step, count in zip(state["steps"], state["num_worlds"], strict=True)
        ]
