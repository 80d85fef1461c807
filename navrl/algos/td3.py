"""Twin delayed deep deterministic policy gradient (TD3)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from navrl.algos.bound_losses import BoundTD3Loss
from navrl.algos.cuda_graph import Move
from navrl.algos.ddpg import DDPG


class TD3(DDPG):
    """TD3 with TorchRL's loss and the interface of :class:`navrl.algos.DDPG`.

    Two critics learn from the lower of their two target values at a target action with noise; actor
    and targets are updated once in ``actor_delay`` updates.

    Args:
        actor: As in DDPG.
        critic: As in DDPG; the second critic is initialized with weights of the same range.
        target_noise: Standard deviation of the noise on target actions, normalized units.
        target_noise_clip: Largest absolute noise, normalized units.
        actor_delay: Number of critic updates per actor update.
        **options: Other arguments of DDPG.

    Raises:
        ValueError: If an argument is out of range.

    Reference:
        Fujimoto et al. (2018). Not in the paper, which trains with DDPG.
    """

    _critic_name = "qvalue_network"

    def __init__(
        self,
        actor: TensorDictModule,
        critic: TensorDictModule,
        target_noise: float = 0.2,
        target_noise_clip: float = 0.5,
        actor_delay: int = 2,
        **options: Any,
    ) -> None:
        if min(target_noise, target_noise_clip) < 0 or actor_delay < 1:
            raise ValueError(
                f"target_noise={target_noise}, target_noise_clip={target_noise_clip}: must be "
                f">= 0; actor_delay={actor_delay}: must be >= 1"
            )
        self._noise = target_noise, target_noise_clip
        self.actor_delay = actor_delay
        super().__init__(actor, critic, **options)
        # The last actor loss, logged between actor updates; one tensor, so recordings can read it.
        self._loss_actor = torch.zeros((), device=self._actor_weights[0].device)

    def _make_loss(
        self, actor: TensorDictModule, critic: TensorDictModule, loss_function: str
    ) -> BoundTD3Loss:
        return BoundTD3Loss(actor, critic, loss_function, *self._noise)

    @property
    def _is_delayed(self) -> bool:
        return self.num_updates % self.actor_delay != 0

    @property
    def _moves_actor(self) -> bool:
        return self._actor_learns and not self._is_delayed

    def _losses(self, batch: TensorDictBase) -> Mapping[str, Tensor]:
        with self.precision.autocast():
            terms = self.loss(batch, with_actor=self._moves_actor)
        if self._moves_actor:
            self._loss_actor.copy_(terms["loss_actor"].detach())
        return {
            "loss_actor": terms["loss_actor"] if self._moves_actor else self._loss_actor.clone(),
            "loss_value": terms["loss_qvalue"],
            "pred_value": terms["pred_value"],
            "target_value": terms["target_value"],
        }

    def _due(self) -> Move:
        if not self._is_delayed:
            return super()._due()
        return Move((self.critic_optimizer,), moves_targets=False)
