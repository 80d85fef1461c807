"""Base class of algorithms whose losses are minimized together, by one optimizer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import LossModule

from navrl.algos.precision import Precision
from navrl.algos.protocols import NonFiniteUpdateError


class OneOptimizer:
    """Algorithm with a loss module of TorchRL and Adam on all of its weights.

    Subclasses define :meth:`update`.

    Args:
        actor: Module that is trained in place.
        loss: Loss module; its trainable parameters are optimized.
        learning_rate: Adam step size of all weights.
        max_gradient_norm: The gradient of all weights is clipped to this norm.
        final_learning_rate_scale: The rate decreases linearly to this multiple until the end of the
            training.
        precision: Number format of matrix products, see :class:`navrl.algos.precision.Precision`.
    """

    def __init__(
        self,
        actor: TensorDictModule,
        loss: LossModule,
        learning_rate: float,
        max_gradient_norm: float,
        final_learning_rate_scale: float = 1.0,
        precision: str = "float32",
    ) -> None:
        """Build the optimizer, on the device of the actor."""
        device = next(actor.parameters()).device
        self.actor, self.max_gradient_norm = actor, max_gradient_norm
        self.precision = Precision(precision, device)
        self.loss = loss.to(device)
        self._weights = [value for value in self.loss.parameters() if value.requires_grad]
        self.optimizer = torch.optim.Adam(self._weights, learning_rate)
        self._learning_rate, self._final_scale = learning_rate, final_learning_rate_scale

    def update(self, batch: TensorDictBase, /) -> dict[str, Tensor]:
        """Update the weights from a batch; return detached scalars."""
        raise NotImplementedError

    def _descend(
        self, batch: TensorDictBase, minimized: Sequence[str], shown: Sequence[str]
    ) -> dict[str, Tensor]:
        """Take one gradient step on the sum of losses; return detached scalars.

        Args:
            batch: ``[B]`` transitions.
            minimized: Names of the losses.
            shown: Names of the terms that are returned, beside ``gradient_norm``.

        Raises:
            NonFiniteUpdateError: If a scalar is NaN or infinite; no weight has changed.
        """
        with self.precision.rounding():
            with self.precision.autocast():
                terms = self.loss(batch)
            self.optimizer.zero_grad()
            torch.stack([terms[name].float() for name in minimized]).sum().backward()
        norm = torch.nn.utils.clip_grad_norm_(self._weights, self.max_gradient_norm)
        scalars = {name: terms[name].detach().mean() for name in shown}
        scalars["gradient_norm"] = norm.detach()
        if not torch.stack(list(scalars.values())).isfinite().all():
            raise NonFiniteUpdateError(scalars, batch)
        self.optimizer.step()
        return scalars

    def update_from_each(self, batches: TensorDictBase) -> dict[str, Tensor]:
        """Update from each batch of ``[K, ...]`` in order; return sums of the scalars."""
        scalars = [self.update(batch) for batch in batches.unbind(0)]
        return {name: torch.stack([each[name] for each in scalars]).sum() for name in scalars[0]}

    def anneal(self, share_done: float) -> None:
        """Scale the learning rate linearly from 1 to ``final_learning_rate_scale``."""
        scale = 1 + min(share_done, 1.0) * (self._final_scale - 1)
        for group in self.optimizer.param_groups:
            group["lr"] = self._learning_rate * scale

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the loss module and of the optimizer."""
        return {"loss": self.loss.state_dict(), "optimizer": self.optimizer.state_dict()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore a copy of a state of :meth:`state_dict`."""
        copied = deepcopy(dict(state))
        self.loss.load_state_dict(copied["loss"])
        self.optimizer.load_state_dict(copied["optimizer"])
