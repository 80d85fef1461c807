"""Proximal policy optimization (PPO)."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from navrl import keys
from navrl.algos.distributions import stochastic_policy
from navrl.algos.one_optimizer import OneOptimizer
from navrl.checks import check_counts, check_positive

_LOSSES = ("loss_objective", "loss_critic")
_SCALARS = (*_LOSSES, "kl_approx", "clip_fraction")


class StateValue(TensorDictModuleBase):
    """Value of a state by a critic of states and actions, whose action input is always zero.

    Args:
        critic: Module that writes ``state_action_value`` from ``action`` and the observation.
        action_size: Number of action dimensions.
    """

    def __init__(self, critic: TensorDictModule, action_size: int) -> None:
        """Take the keys of the critic without the action."""
        super().__init__()
        self.critic, self.action_size = critic, action_size
        self.in_keys = [str(key) for key in critic.in_keys if key != keys.ACTION]
        self.out_keys = ["state_value"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``state_value [*B, 1]``."""
        seen = tensordict.select(*self.in_keys)
        action = torch.zeros(*tensordict.batch_size, self.action_size, device=tensordict.device)
        value = self.critic(seen.set(keys.ACTION, action)).get(keys.STATE_ACTION_VALUE)
        return tensordict.set("state_value", value)


class PPO(OneOptimizer):
    """PPO with TorchRL's clipped loss and generalized advantages, from whole rollouts.

    The actor writes the mean action and is what drives and is saved. The distribution around it
    has a fixed deviation before the tanh; experience must be collected with exactly that noise
    (:class:`navrl.algos.SquashedExploration`), in all worlds, and by one policy per rollout
    (:class:`navrl.training.Rollouts`). So the probability of an action at its collection is
    computed at the beginning of an update.

    Args:
        actor: Module that writes ``action`` in [-1, 1].
        critic: Module that writes ``state_action_value``; its action input is set to zero.
        action_size: Number of action dimensions.
        gamma: Discount factor per step.
        gae_lambda: Decay of the advantages' trace per step.
        deviation: Of the noise before the tanh.
        clip: The ratio of probabilities is clipped to 1 - clip and 1 + clip.
        learning_rate: Adam step size of all weights; decreases linearly to zero.
        epochs: Passes over a rollout per update.
        minibatch_size: Transitions per gradient step.
        max_gradient_norm: The gradient of all weights is clipped to this norm.

    Raises:
        ValueError: If an argument is out of range.

    Reference:
        Schulman et al., "Proximal Policy Optimization Algorithms", arXiv 1707.06347.
    """

    def __init__(
        self,
        actor: TensorDictModule,
        critic: TensorDictModule,
        action_size: int = 2,
        gamma: float = 0.98,
        gae_lambda: float = 0.95,
        deviation: float = 0.4,
        clip: float = 0.2,
        learning_rate: float = 3e-4,
        epochs: int = 4,
        minibatch_size: int = 1024,
        max_gradient_norm: float = 1.0,
    ) -> None:
        """Check the values, then build loss, advantage and optimizer."""
        if not 0 <= gamma <= 1 or not 0 <= gae_lambda <= 1:
            raise ValueError(f"gamma={gamma}, gae_lambda={gae_lambda}: must be in [0, 1]")
        check_positive(deviation=deviation, clip=clip, learning_rate=learning_rate)
        check_positive(max_gradient_norm=max_gradient_norm)
        check_counts(epochs=epochs, minibatch_size=minibatch_size)
        self.epochs, self.minibatch_size = epochs, minibatch_size
        self.policy = stochastic_policy(actor, action_size, deviation, is_learned=False)
        value = StateValue(critic, action_size)
        loss = ClipPPOLoss(
            self.policy,
            value,  # pyright: ignore[reportArgumentType] -- any module with keys
            clip_epsilon=clip,
            entropy_bonus=False,
            normalize_advantage=True,
        )
        super().__init__(
            actor, loss, learning_rate, max_gradient_norm, final_learning_rate_scale=0.0
        )
        self.advantage = GAE(
            gamma=gamma,
            lmbda=gae_lambda,
            value_network=value,  # pyright: ignore[reportArgumentType]
            deactivate_vmap=True,
        )

    def update(self, rollout: TensorDictBase) -> dict[str, Tensor]:
        """Take the gradient steps of all epochs on a rollout.

        Args:
            rollout: ``[N, T]`` transitions of N worlds in T steps, in order.

        Returns:
            Detached scalars, means over the gradient steps: the losses, the approximate
            Kullback-Leibler divergence and the share of clipped ratios.

        Raises:
            NonFiniteUpdateError: If a scalar is NaN or infinite; earlier steps of the same rollout
                have changed the weights.
        """
        with torch.no_grad():
            distribution = self.policy.get_dist(rollout.copy())
            probability = distribution.log_prob(rollout.get(keys.ACTION))
            name = str(self.loss.tensor_keys.sample_log_prob)
            rollout = rollout.copy().set(name, probability)
            self.advantage(rollout)
        steps, found = rollout.reshape(-1), []
        for _ in range(self.epochs):
            for rows in torch.randperm(len(steps)).split(self.minibatch_size):
                found.append(self._descend(steps[rows], _LOSSES, _SCALARS))
        return {name: torch.stack([each[name] for each in found]).mean() for name in found[0]}
