"""Behavior policy: actor, exploration noise and an optional guide in some worlds."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from navrl import keys
from navrl.algos import Exploration


class Behavior:
    """Behavior policy that acts in a batch of worlds to collect experience.

    Args:
        actor: Policy in training, which writes a normalized action.
        exploration: Noise on the actions.
        guide: Controller that writes a normalized action; ``None`` for no guide.
        guided_fraction: Share of the worlds controlled by the guide (with noise). Their transitions
            enter the replay like all others, because DDPG is off-policy. Not in the paper.
        guided_frames: Frames after which the guide is disabled; ``None`` for never.
        random_frames: Initial frames with uniformly random actions in the other worlds.

    Raises:
        ValueError: If a share is outside [0, 1], a count is negative or a guide is missing.
    """

    def __init__(
        self,
        actor: TensorDictModuleBase,
        exploration: Exploration,
        guide: Callable[[TensorDictBase], TensorDictBase] | None = None,
        guided_fraction: float = 0.0,
        guided_frames: int | None = None,
        random_frames: int = 10_000,
    ) -> None:
        if not 0 <= guided_fraction <= 1 or random_frames < 0:
            raise ValueError(
                f"guided_fraction={guided_fraction}: must be in [0, 1]; "
                f"random_frames={random_frames}: must be >= 0"
            )
        if guided_fraction and guide is None:
            raise ValueError(f"guided_fraction={guided_fraction}: needs a guide, got None")
        self.actor, self.exploration, self.guide = actor, exploration, guide
        self.guided_fraction = guided_fraction
        self.guided_frames, self.random_frames = guided_frames, random_frames

    @torch.no_grad()
    def act(self, tensordict: TensorDictBase, frames: int) -> TensorDictBase:
        """Write ``action [N, C]`` in [-1, 1] into ``tensordict`` after ``frames`` env steps."""
        last = tensordict.get(keys.ACTION, None)  # what was driven in the step before, with noise
        self.actor(tensordict)
        if frames < self.random_frames:
            shape = tensordict.get(keys.ACTION).shape
            tensordict.set(keys.ACTION, torch.rand(shape, device=tensordict.device) * 2 - 1)
        guided = self._num_guided(len(tensordict), frames)
        if guided:
            action = tensordict.get(keys.ACTION).clone()
            action[:guided] = self._guide_action(
                cast(TensorDictBase, tensordict[:guided]).copy(), last
            )
            tensordict.set(keys.ACTION, action)
        return self.exploration(tensordict, frames)

    def _guide_action(self, tensordict: TensorDictBase, last: Tensor | None) -> Tensor:
        """Return the guide's action ``[G, C]``; it reads its last action, not the actor's next."""
        assert self.guide is not None  # a share is guided
        if last is None:
            return self.guide(tensordict.exclude(keys.ACTION)).get(keys.ACTION)
        return self.guide(tensordict.set(keys.ACTION, last[: len(tensordict)])).get(keys.ACTION)

    def _num_guided(self, num_worlds: int, frames: int) -> int:
        if self.guided_frames is not None and frames >= self.guided_frames:
            return 0
        return round(self.guided_fraction * num_worlds)
