"""Distribution around the action of an actor, for algorithms that learn from probabilities."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn
from torchrl.modules import ProbabilisticActor, TanhNormal

from navrl import keys
from navrl.algos.exploration import MAX_MEAN


class ActionSpread(TensorDictModuleBase):
    """Normal distribution before the tanh, whose mean becomes the actor's action.

    It does not change ``action``, which may be that of a transition.

    Args:
        actor: Module that writes ``action`` in [-1, 1].
        action_size: Number of action dimensions C.
        deviation: Initial deviation before the tanh, which does not depend on the observation.
        is_learned: Whether the deviation is a parameter of each dimension.
    """

    def __init__(
        self, actor: TensorDictModule, action_size: int, deviation: float, is_learned: bool
    ) -> None:
        """Create the deviation on the device of the actor."""
        super().__init__()
        self.in_keys, self.out_keys = [str(key) for key in actor.in_keys], ["loc", "scale"]
        self.actor = actor
        device = next(actor.parameters()).device
        log_std = torch.full((action_size,), math.log(deviation), device=device)
        self.log_std = nn.Parameter(log_std, requires_grad=is_learned)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``loc`` and ``scale [*B, C]``."""
        action = self.actor(tensordict.select(*self.in_keys)).get(keys.ACTION)
        location = torch.atanh(action.clamp(-MAX_MEAN, MAX_MEAN))
        scale = self.log_std.exp().expand_as(location)
        return tensordict.set("loc", location).set("scale", scale)


def stochastic_policy(
    actor: TensorDictModule, action_size: int, deviation: float, is_learned: bool
) -> ProbabilisticActor:
    """Return TorchRL's policy of the distribution; arguments as for :class:`ActionSpread`."""
    spread = ActionSpread(actor, action_size, deviation, is_learned)
    return ProbabilisticActor(
        spread,  # pyright: ignore[reportArgumentType] -- any module with keys
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
