"""Deep deterministic policy gradient (DDPG)."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from functools import partial

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictParams
from torch import Tensor
from torchrl.objectives import SoftUpdate
from torchrl.objectives.utils import ValueEstimators

from navrl.algos.action_smoothness import ActionSmoothness
from navrl.algos.adam import adam_optimizer, load_adam, set_learning_rate
from navrl.algos.bound_losses import BoundDDPGLoss, BoundTD3Loss
from navrl.algos.cuda_graph import CapturedUpdates, Move
from navrl.algos.precision import Precision
from navrl.algos.protocols import NonFiniteUpdateError


class DDPG:
    """DDPG with TorchRL's loss, two Adam optimizers and a soft target update.

    Args:
        actor: Module that writes ``action`` in [-1, 1].
        critic: Module that writes ``state_action_value`` from ``action`` and the observation.
        gamma: Discount factor per step.
        actor_learning_rate: Adam step size of the actor.
        critic_learning_rate: Adam step size of the critic.
        final_learning_rate_scale: Both rates decrease linearly to this multiple until the end of
            the training; see :meth:`anneal`.
        tau: Share of the online weights in the soft target update after each update.
        max_gradient_norm: Gradients of each network are clipped to this norm.
        loss_function: ``"l2"`` or ``"smooth_l1"`` on the temporal difference.
        precision: ``"float32"``; ``"bfloat16"`` to run matrix products under autocast;
            ``"tfloat32"`` to round only their inputs, supported by GPUs but not by CPUs; or
            ``"auto"`` for the fastest, see :class:`navrl.algos.precision.Precision`.
        fused_optimizer: Whether Adam uses a single pass over memory instead of a dozen.
        action_smoothness: Arguments of :class:`navrl.algos.ActionSmoothness`, a penalty in the loss
            of the actor; ``None`` is none.
        actor_starts_updates: Number of first updates that change the critic only, for an actor that
            is better than a new critic (``warm_start``).
        cuda_graph: Whether updates are recorded as CUDA graphs and replayed; see
            :class:`navrl.algos.cuda_graph.CapturedUpdates`. Networks must be on a CUDA device. A
            non-finite update is reported a few updates later; weights are not modified in between.

    Raises:
        ValueError: If an argument is out of range, or ``cuda_graph`` is not possible.

    Reference:
        Paper Sec. IV-B and V-A: gamma 0.98, learning rates 1e-4. Both networks have targets
        (Lillicrap et al., 2016); the paper does not give tau, the loss function and clipping.
    """

    _critic_name = "value_network"

    def __init__(
        self,
        actor: TensorDictModule,
        critic: TensorDictModule,
        gamma: float = 0.98,
        actor_learning_rate: float = 1e-4,
        critic_learning_rate: float = 1e-4,
        final_learning_rate_scale: float = 1.0,
        tau: float = 0.005,
        max_gradient_norm: float = 10.0,
        loss_function: str = "l2",
        precision: str = "float32",
        fused_optimizer: bool = True,
        cuda_graph: bool = False,
        action_smoothness: Mapping[str, float] | None = None,
        actor_starts_updates: int = 0,
    ) -> None:
        if not 0 <= gamma <= 1 or not 0 < tau <= 1:
            raise ValueError(f"gamma={gamma}: must be in [0, 1]; tau={tau}: must be in (0, 1]")
        if not 0 <= final_learning_rate_scale <= 1:
            raise ValueError(
                f"final_learning_rate_scale={final_learning_rate_scale}: must be in [0, 1]"
            )
        if min(actor_learning_rate, critic_learning_rate, max_gradient_norm) <= 0:
            raise ValueError(
                f"actor_learning_rate={actor_learning_rate}, critic_learning_rate="
                f"{critic_learning_rate}, max_gradient_norm={max_gradient_norm}: must be > 0"
            )
        if actor_starts_updates < 0:
            raise ValueError(f"actor_starts_updates={actor_starts_updates}: must be >= 0")
        self.actor_starts_updates, self.num_updates = actor_starts_updates, 0
        self.actor = actor
        self.gamma = gamma
        self.max_gradient_norm = max_gradient_norm
        self.loss = self._make_loss(actor, critic, loss_function)
        self.loss.smoothness = ActionSmoothness(**(action_smoothness or {}))
        self.loss.make_value_estimator(ValueEstimators.TD0, gamma=gamma)
        self._actor_weights = list(self.loss.actor_network_params.parameters())
        self._critic_weights = list(self._params(self._critic_name).parameters())
        self.precision = Precision(precision, self._actor_weights[0].device)
        self._check_graph(cuda_graph, fused_optimizer)
        adam = partial(adam_optimizer, fused=fused_optimizer, capturable=cuda_graph)
        self.actor_optimizer = adam(self._actor_weights, actor_learning_rate)
        self.critic_optimizer = adam(self._critic_weights, critic_learning_rate)
        self._final_scale = final_learning_rate_scale
        self._optimizers = (
            (self.actor_optimizer, actor_learning_rate),
            (self.critic_optimizer, critic_learning_rate),
        )
        self.target_update = SoftUpdate(self.loss, tau=tau)
        self._online, self._targets = self._weight_pairs()
        self._captured = self._make_captured(tau) if cuda_graph else None

    def _make_loss(
        self, actor: TensorDictModule, critic: TensorDictModule, loss_function: str
    ) -> BoundDDPGLoss | BoundTD3Loss:
        return BoundDDPGLoss(actor, critic, loss_function)

    def _params(self, name: str) -> TensorDictParams:
        return getattr(self.loss, f"{name}_params")

    def _check_graph(self, cuda_graph: bool, fused_optimizer: bool) -> None:
        device = self._actor_weights[0].device
        if cuda_graph and device.type != "cuda":
            raise ValueError(
                f"cuda_graph=True: needs the networks on a CUDA device, but they are on {device}; "
                "set device=cuda, or cuda_graph=False"
            )
        if cuda_graph and not fused_optimizer:
            raise ValueError("cuda_graph=True: needs fused_optimizer=True, got False")

    def _make_captured(self, tau: float) -> CapturedUpdates:
        optimizers = (self.actor_optimizer, self.critic_optimizer)
        weights = self._online, self._targets
        return CapturedUpdates(self._gradients, self._due, optimizers, *weights, tau)

    def _weight_pairs(self) -> list[list[Tensor]]:
        """Return all weights and, in the same order, their targets."""
        pairs = [
            (self._params(name), self._params(f"target_{name}"))
            for name in ("actor_network", self._critic_name)
        ]
        keys = [list(online.keys(True, True)) for online, _ in pairs]
        return [
            [params.get(key).data for params, own in zip(side, keys, strict=True) for key in own]
            for side in zip(*pairs, strict=True)
        ]

    def _move_targets(self) -> None:
        # Equivalent to SoftUpdate.step() without its traversal of nested tensors.
        torch._foreach_lerp_(self._targets, self._online, 1 - self.target_update.eps)

    def anneal(self, share_done: float) -> None:
        """Scale both learning rates linearly from 1 to ``final_learning_rate_scale``.

        Args:
            share_done: Completed share of the training, in [0, 1]. It depends only on the trainer's
                counters, so a resumed run continues exactly.
        """
        scale = 1 + min(share_done, 1.0) * (self._final_scale - 1)
        for optimizer, initial in self._optimizers:
            for group in optimizer.param_groups:
                set_learning_rate(group, initial * scale)

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step on both networks and update the targets.

        Args:
            batch: ``[B]`` transitions; ``td_error`` is written into it, except with ``cuda_graph``.

        Returns:
            Detached scalars: losses, mean value and target, gradient norms before clipping.

        Raises:
            NonFiniteUpdateError: If a scalar is NaN or infinite; no weight has changed.
        """
        if self._captured is not None:
            return self.update_from_each(batch.unsqueeze(0))
        scalars = self._gradients(batch)
        if not torch.stack(list(scalars.values())).isfinite().all():
            raise NonFiniteUpdateError(scalars, batch)
        move = self._due()
        for optimizer in move.optimizers:
            optimizer.step()
        if move.moves_targets:
            self._move_targets()
        self._count()
        return scalars

    def update_from_each(self, batches: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step per batch, with less host synchronization on a GPU.

        Args:
            batches: ``[K, B]`` transitions.

        Returns:
            Sums over the steps of the scalars of :meth:`update`.

        Raises:
            NonFiniteUpdateError: If a scalar is NaN or infinite; the remaining steps are not taken.
        """
        if self._captured is not None:
            self._check_captured(self._captured)
            return self._captured(batches, after_each=self._count)
        sums: dict[str, Tensor] = {}
        for batch in batches.unbind(0):
            for name, value in self.update(batch).items():
                sums[name] = sums[name] + value if name in sums else value
        return sums

    def _due(self) -> Move:
        """Return the optimizers and targets that the current update changes."""
        actor = (self.actor_optimizer,) if self._actor_learns else ()
        return Move((*actor, self.critic_optimizer), moves_targets=True)

    @property
    def _actor_learns(self) -> bool:
        return self.num_updates >= self.actor_starts_updates

    def _count(self) -> None:
        """Count an update that has been launched."""
        self.num_updates += 1

    def _check_captured(self, captured: CapturedUpdates, wait: bool = False) -> None:
        failure = captured.failure(wait)
        if failure is not None:
            raise NonFiniteUpdateError(*failure)

    def _gradients(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Write clipped gradients to the weights; return the scalars of the update."""
        with self.precision.rounding():
            terms = self._losses(batch)
            self.actor_optimizer.zero_grad(set_to_none=True)
            self.critic_optimizer.zero_grad(set_to_none=True)
            # Only the two losses, because the other returned terms are not detached.
            (terms["loss_actor"] + terms["loss_value"]).backward()
        actor_norm, critic_norm = map(self._clip, (self._actor_weights, self._critic_weights))
        scalars = {
            "loss_actor": terms["loss_actor"],
            "loss_critic": terms["loss_value"],
            "q_mean": terms["pred_value"].float().mean(),
            "q_target_mean": terms["target_value"].float().mean(),
            "gradient_norm_actor": actor_norm,
            "gradient_norm_critic": critic_norm,
        }
        return {name: value.detach().float() for name, value in scalars.items()}

    def _clip(self, weights: list[Tensor]) -> Tensor:
        """Clip gradients, if present; return their norm before clipping."""
        if weights[0].grad is None:
            return weights[0].new_zeros(())
        return torch.nn.utils.clip_grad_norm_(weights, self.max_gradient_norm)

    def _losses(self, batch: TensorDictBase) -> Mapping[str, Tensor]:
        """Return at least ``loss_actor``, ``loss_value``, ``pred_value`` and ``target_value``."""
        with self.precision.autocast():
            return self.loss(batch)

    def state_dict(self) -> dict:
        """Return weights, target weights, optimizer states and the number of updates.

        Raises:
            NonFiniteUpdateError: If an earlier recorded update was not finite and has not been
                reported yet.
        """
        if self._captured is not None:
            self._check_captured(self._captured, wait=True)
        return {
            "loss": self.loss.state_dict(),
            "actor_optimizer": self.actor_optimizer.state_dict(),
            "critic_optimizer": self.critic_optimizer.state_dict(),
            "num_updates": self.num_updates,
        }

    def load_state_dict(self, state: dict) -> None:
        """Restore a copy of a state of :meth:`state_dict`, saved on any device."""
        # Copied, because optimizers store the given tensors and would share them between learners.
        state = deepcopy(state)
        self.loss.load_state_dict(state["loss"])  # in place: optimizers and targets reference it
        load_adam(self.actor_optimizer, state["actor_optimizer"])
        load_adam(self.critic_optimizer, state["critic_optimizer"])
        self.num_updates = state.get("num_updates", self.actor_starts_updates)  # of older states
        if self._captured is not None:
            self._captured.reset()
