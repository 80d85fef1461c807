"""Protocols of learning algorithms and of exploration.

They contain the members that the trainer uses; any class with these members fits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from tensordict import TensorDictBase
from torch import Tensor

from navrl.algos.precision import Precision


class NonFiniteUpdateError(FloatingPointError):
    """Error for a NaN or infinite loss or gradient, raised before any weight changes.

    Args:
        terms: The scalars of the update.
        batch: The transitions that led to it.
    """

    def __init__(self, terms: Mapping[str, Tensor], batch: TensorDictBase) -> None:
        values = ", ".join(f"{name}={float(value):g}" for name, value in terms.items())
        super().__init__(f"the update is not finite: {values}")
        self.terms, self.batch = terms, batch


class Algorithm(Protocol):
    """Learning algorithm, built from its YAML node with ``actor`` and ``critic`` added.

    It trains both modules in place: what drives worlds and is saved is ``actor``.

    Attributes:
        precision: Number format of its matrix products, for the log.
    """

    precision: Precision

    def update_from_each(self, batches: TensorDictBase) -> Mapping[str, Tensor]:
        """Take one gradient step from each of K batches ``[K, B]`` in order.

        Returns:
            Sums over the K steps of detached scalars, which the log divides by K.

        Raises:
            NonFiniteUpdateError: If an update is not finite; no weight has changed then.
        """
        ...

    def anneal(self, share_done: float) -> None:
        """Set what depends on the share of the training that is done, in [0, 1]."""

    def state_dict(self) -> dict[str, Any]:
        """Return all that :meth:`load_state_dict` needs to continue bit for bit."""
        ...

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a state of :meth:`state_dict`, on this device."""


class Exploration(Protocol):
    """Noise on the actions of an actor while experience is collected."""

    def sigma(self, frames: int) -> float:
        """Return the noise scale after ``frames`` environment steps, for the log."""
        ...

    def __call__(self, tensordict: TensorDictBase, frames: int) -> TensorDictBase:
        """Change ``action [N, C]`` in [-1, 1] in place, unless exploring is off."""
        ...


def check_protocol(name: str, built: object, protocol: type) -> None:
    """Check that an object has the members of a protocol.

    Raises:
        ValueError: If one is missing, naming it.
    """
    needed = [key for key in vars(protocol) if key == "__call__" or not key.startswith("_")]
    needed += list(getattr(protocol, "__annotations__", {}))
    missing = sorted({key for key in needed if not hasattr(built, key)})
    if missing:
        raise ValueError(f"{name}={type(built).__name__}: must have {', '.join(missing)}")
