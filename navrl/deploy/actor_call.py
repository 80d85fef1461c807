"""Call of an actor on one observation, and what it passes on to its next call."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor

from navrl import keys

_ATTENTION = (keys.SPATIAL_ATTENTION, keys.TEMPORAL_ATTENTION)


class ActorCall:
    """Call an actor and pass on what it writes for its next call, e.g. a recurrent state.

    An entry that the actor writes under ``"next"``, as TorchRL's recurrent modules do, is read at
    the root by its next call.

    Args:
        actor: Writes ``action``.
    """

    def __init__(self, actor: TensorDictModule) -> None:
        """Find the entries that the actor writes for its next call."""
        self._actor = actor
        reads, writes = getattr(actor, "in_keys", ()), getattr(actor, "out_keys", ())
        self._is_plain = type(actor) is TensorDictModule and writes == [keys.ACTION]
        own = (key for key in writes if key not in (keys.ACTION, *_ATTENTION))
        self._own = {key: _at_root(key) for key in own if _at_root(key) in reads}

    def __call__(self, now: TensorDictBase) -> dict[str, Tensor]:
        """Return the action, the attention, and the entries of the next call by root key."""
        actor = self._actor
        if self._is_plain:
            # Call the network directly: a TensorDictModule checks for packages at every call.
            return {keys.ACTION: actor.module(*(now.get(key) for key in actor.in_keys))}
        written = actor(now.copy())
        found = {key: written[key] for key in (keys.ACTION, *_ATTENTION) if key in written}
        return found | {root: written[key] for key, root in self._own.items()}

    def passed_on(self, past: TensorDictBase) -> dict[str, Tensor]:
        """Return what the next call reads of the last one: its action and entries of its own."""
        names = (keys.ACTION, *self._own.values())
        return {name: past.get(name) for name in names if name in past}


def _at_root(key: str | tuple[str, ...]) -> str:
    return key if isinstance(key, str) else key[-1]
