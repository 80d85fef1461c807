"""Sensors behind the inputs of a policy, and a wrapper that withholds other keys."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from tensordict import TensorDictBase
from torchrl.envs import Transform, TransformedEnv

from navrl import keys
from navrl.deprecation import RENAMED_INPUTS
from navrl.policies.controller import is_privileged
from navrl.transforms import Normalize

SOURCES = {
    "scan": (keys.RANGES, keys.MEASURED),
    "pose": (keys.POSE,),
    "path": (keys.PATH,),
    "odometry": (keys.VELOCITY, keys.SCAN_MOTION, keys.MOTION_AHEAD, keys.VELOCITY_AHEAD),
    "true state": (keys.PEDESTRIAN_BOXES, keys.PEDESTRIAN_CLEARANCE, keys.TRUE_POSE),
}
"""Raw keys of the environment by what they come from."""


def observed_sources(policy: object, env: TransformedEnv) -> list[str]:
    """Return which of :data:`SOURCES` a policy may read, directly or through transforms.

    Args:
        policy: With ``in_keys`` it reads these, see :class:`RestrictedPolicy`; without, everything
            but the true state.
        env: Its environment.

    Returns:
        Names in the order of :data:`SOURCES`; "true state" for a privileged policy.
    """
    declared = getattr(policy, "in_keys", None)
    every = {key for raw in SOURCES.values() for key in raw} - set(SOURCES["true state"])
    needed = every if declared is None else _traced(env.transform, declared)
    found = [name for name, raw in SOURCES.items() if needed & set(raw)]
    hidden = "true state"
    if is_privileged(policy):
        return [*(name for name in found if name != hidden), hidden]
    return [name for name in found if name != hidden]


def _traced(transform: Transform, needed: Iterable[str]) -> set[str]:
    """Return the keys before the transforms from which the needed ones are computed."""
    found = {str(key) for key in needed}
    for step in reversed(list(transform)):  # pyright: ignore[reportArgumentType] -- a Compose
        in_keys, out_keys = ([str(key) for key in side] for side in (step.in_keys, step.out_keys))
        written = found & set(out_keys)
        if isinstance(step, Normalize):  # each output has one input
            read = {one for one, other in zip(in_keys, out_keys, strict=True) if other in written}
        else:
            read = set(in_keys) if written else set()
        found = (found - written) | read
    return found


class RestrictedPolicy:
    """Pass a policy the keys that it declares, or all but the true state, and its last action.

    So that what a table says of it holds. Other attributes are those of the policy. What it returns
    is added to the observation, which it cannot change; entries that it added itself, such as a
    hidden state, it may replace at later steps.

    Args:
        policy: Maps a TensorDict to one with ``action [N, C]``. If it is privileged, every key is
            passed; without ``in_keys`` every key but those of the true state.
    """

    def __init__(self, policy: Callable[..., TensorDictBase]) -> None:
        """Determine the keys to pass."""
        self._policy, declared = policy, getattr(policy, "in_keys", None)
        self._keys: list[str] | None = None
        if declared is not None and not is_privileged(policy):
            renamed = [RENAMED_INPUTS[key] for key in declared if key in RENAMED_INPUTS]
            self._keys = [*declared, *renamed, keys.ACTION]
        self._hidden = () if is_privileged(policy) else SOURCES["true state"]
        self._own = {keys.ACTION}  # entries that the policy has added

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, and further keys that the policy adds.

        Raises:
            ValueError: If the policy returns something else than a TensorDict with an action.
        """
        if self._keys is None:
            seen = tensordict.exclude(*self._hidden)
        else:
            seen = tensordict.select(*self._keys, strict=False)
        decided = self._policy(seen)
        if not isinstance(decided, TensorDictBase) or decided.get(keys.ACTION, None) is None:
            found = type(decided).__name__
            raise ValueError(f"policy: must return a TensorDict with 'action', got {found}")
        known = set(tensordict.keys()) - self._own
        added = decided.exclude(*known)
        self._own.update(added.keys())
        return tensordict.update(added)

    def __getattr__(self, name: str) -> object:
        return getattr(self._policy, name)
