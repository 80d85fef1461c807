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
    "true state": (
        keys.PEDESTRIAN_BOXES,
        keys.PEDESTRIAN_CLEARANCE,
        keys.TRUE_POSE,
        keys.CONTACT,
        keys.OUTCOME,
        keys.REWARD_TERMS,
    ),
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

    Raises:
        ValueError: If it declares a key of the true state without being privileged.
    """

    def __init__(self, policy: Callable[..., TensorDictBase]) -> None:
        """Determine the keys to pass."""
        self._policy = policy
        is_seeing = is_privileged(policy)
        self._hidden = () if is_seeing else SOURCES["true state"]
        self._declared = None if is_seeing else getattr(policy, "in_keys", None)
        for key in self._declared or ():
            if key in self._hidden or key[0] in self._hidden:
                raise ValueError(
                    f"policy: in_keys has {key!r}, which is of the true state: only a class with "
                    "privileged = True may read it"
                )
        self._own = {keys.ACTION}  # entries that the policy has added

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, and further keys that the policy adds.

        Raises:
            ValueError: If a declared key is neither observed nor added by the policy, or it returns
                something else than a TensorDict with a finite action ``[N, C]``.
        """
        observed = [name for name in map(str, tensordict.keys()) if name not in self._hidden]
        missing = [key for key in self._declared or () if _present(key) not in observed]
        try:
            decided = self._policy(self._seen(tensordict))
        except Exception as error:
            if missing:
                raise self._unobserved(missing[0], observed) from error
            raise
        _check_decided(decided, tensordict.batch_size.numel())
        known = set(tensordict.keys()) - self._own
        added = decided.exclude(*known)
        self._own.update(added.keys())
        unwritten = [key for key in missing if key not in self._own]
        if unwritten:
            raise self._unobserved(unwritten[0], observed)
        return tensordict.update(added)

    def _seen(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self._declared is None:
            return tensordict.exclude(*self._hidden)
        renamed = [RENAMED_INPUTS[key] for key in self._declared if key in RENAMED_INPUTS]
        return tensordict.select(*self._declared, *renamed, keys.ACTION, strict=False)

    def _unobserved(self, key: str, observed: Iterable[str]) -> ValueError:
        return ValueError(
            f"policy: in_keys has {key!r}: must be observed, or written by the policy; "
            f"observed: {', '.join(sorted(observed))}"
        )

    def __getattr__(self, name: str) -> object:
        return getattr(self._policy, name)


def _present(key: str) -> str:
    """Return the name of a declared key in an observation; nested keys by their first part."""
    return RENAMED_INPUTS.get(key, key) if isinstance(key, str) else key[0]


def _check_decided(decided: object, num_worlds: int) -> None:
    if not isinstance(decided, TensorDictBase):
        raise ValueError(
            f"policy: must return a TensorDict with 'action', got {type(decided).__name__}"
        )
    action = decided.get(keys.ACTION, None)
    if action is None:
        found = ", ".join(sorted(map(str, decided.keys()))) or "nothing"
        raise ValueError(f"policy: must return a TensorDict with 'action', got one with {found}")
    if action.ndim != 2 or action.shape[0] != num_worlds:
        shape = list(action.shape)
        raise ValueError(f"policy: action has shape {shape}: must be [{num_worlds}, C]")
    if not action.isfinite().all():
        raise ValueError(f"policy: action={action[~action.isfinite()][0]}: must be finite")
