"""Soft actor-critic (SAC)."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import SoftUpdate

from navrl.algos.bound_sac_loss import BoundSACLoss
from navrl.algos.distributions import stochastic_policy
from navrl.algos.one_optimizer import OneOptimizer
from navrl.checks import check_positive

_LOSSES = ("loss_actor", "loss_qvalue", "loss_alpha")
_DEVIATION = 0.37  # before the tanh, at the start


class SAC(OneOptimizer):
    """Soft actor-critic with TorchRL's loss: two critics and a learned temperature.

    The actor writes the mean action and is what drives and is saved; the distribution around it has
    a deviation that does not depend on the state. Experience is collected with the noise of
    ``exploration``, since the algorithm is off-policy.

    Args:
        actor: Module that writes ``action`` in [-1, 1].
        critic: Module that writes ``state_action_value`` from ``action`` and the observation.
        action_size: Number of action dimensions.
        gamma: Discount factor per step.
        learning_rate: Adam step size of all weights.
        tau: Share of the online weights in the target update after each update.
        max_gradient_norm: The gradient of all weights is clipped to this norm.
        initial_temperature: Weight of the entropy at the start, before it is learned; at 1 the
            entropy of an episode exceeds its reward.
        final_learning_rate_scale: The rate decreases linearly to this multiple until the end of the
            training.
        precision: Number format of matrix products, see :class:`navrl.algos.precision.Precision`.

    Raises:
        ValueError: If an argument is out of range.

    Reference:
        Haarnoja et al., "Soft Actor-Critic Algorithms and Applications", arXiv 1812.05905.
    """

    def __init__(
        self,
        actor: TensorDictModule,
        critic: TensorDictModule,
        action_size: int = 2,
        gamma: float = 0.98,
        learning_rate: float = 3e-4,
        tau: float = 0.005,
        max_gradient_norm: float = 10.0,
        initial_temperature: float = 0.05,
        final_learning_rate_scale: float = 1.0,
        precision: str = "float32",
    ) -> None:
        """Check the values, then build loss and optimizer."""
        if not 0 <= gamma <= 1 or not 0 < tau <= 1:
            raise ValueError(f"gamma={gamma}: must be in [0, 1]; tau={tau}: must be in (0, 1]")
        check_positive(
            learning_rate=learning_rate,
            max_gradient_norm=max_gradient_norm,
            initial_temperature=initial_temperature,
            final_learning_rate_scale=final_learning_rate_scale,
        )
        policy = stochastic_policy(actor, action_size, _DEVIATION, is_learned=True)
        loss = BoundSACLoss(policy, critic, initial_temperature, -float(action_size))
        super().__init__(
            actor, loss, learning_rate, max_gradient_norm, final_learning_rate_scale, precision
        )
        self.loss.make_value_estimator(gamma=gamma)
        self.target_update = SoftUpdate(self.loss, tau=tau)

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step on actor, critics and temperature, and update the targets.

        Args:
            batch: ``[B]`` transitions.

        Returns:
            Detached scalars: the losses, the temperature ``alpha``, the ``entropy`` and the
            gradient norm before clipping.

        Raises:
            NonFiniteUpdateError: If a scalar is NaN or infinite; no weight has changed.
        """
        scalars = self._descend(batch, _LOSSES, (*_LOSSES, "alpha", "entropy"))
        self.target_update.step()
        return scalars
