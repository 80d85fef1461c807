"""Previous scan as TensorDict keys."""

from __future__ import annotations

from tensordict import TensorDictBase
from torchrl.data import Composite, TensorSpec

from navrl import keys
from navrl.transforms.observation_map import (
    Keys,
    cloned,
    nested_keys,
    observed_specs,
    read,
    read_spec,
)
from navrl.transforms.stateful import StatefulTransform


class ScanHistory(StatefulTransform):
    """Add the entries of time t-1 to those of time t.

    Previous values are stored in the TensorDict, not in the transform: the value at t-1 is read
    from the root that the caller steps. Partial resets, interleaved streams, planning and replay
    therefore each have their own history. After a reset the previous value equals the current one,
    which shows no motion.

    Args:
        in_keys: Any number of entries of time t, of any shape.
        out_keys: Keys of the same entries of time t-1, each in its own frame.

    Raises:
        ValueError: If the numbers of out_keys and in_keys differ, or later if the environment lacks
            a key.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> history = ScanHistory(in_keys=["points"], out_keys=["points_previous"])
        >>> first, second = torch.zeros(1, 2, 2), torch.ones(1, 2, 2)
        >>> data = TensorDict({"points": first, "next": {"points": second}}, [1])
        >>> data["points_previous"] = first
        >>> bool((history(data)["next", "points_previous"] == first).all())
        True

    Reference:
        Paper Sec. IV-A, the scans B_{t-1} and B_t. The first step of an episode duplicates the
        scan, as in the authors' precursor.
    """

    def __init__(
        self,
        in_keys: Keys = (keys.POINTS, keys.RETURNS),
        out_keys: Keys = (keys.PREVIOUS_POINTS, keys.PREVIOUS_RETURNS),
    ) -> None:
        super().__init__(in_keys=nested_keys(in_keys), out_keys=nested_keys(out_keys))
        if len(self.in_keys) != len(self.out_keys):
            raise ValueError(
                f"ScanHistory: out_keys={self.out_keys}: must be as many as in_keys "
                f"({self.in_keys})"
            )

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for now, previous in zip(self.in_keys, self.out_keys, strict=True):
            # Cloned, because workers of a ParallelEnv overwrite the root's memory at the next step.
            next_tensordict.set(previous, read(self, tensordict, now).clone())
        return next_tensordict

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Fill the missing past with the current scan."""
        for now, previous in zip(self.in_keys, self.out_keys, strict=True):
            next_tensordict.set(previous, read(self, next_tensordict, now).clone())
        return next_tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the specs of the previous entries to those of the environment."""
        observation_spec = cloned(observation_spec)
        specs = [read_spec(self, observation_spec, key).clone() for key in self.in_keys]
        for key, spec in zip(self.out_keys, specs, strict=True):
            observation_spec[key] = spec
        return observation_spec

    def transform_input_spec(self, input_spec: TensorSpec) -> Composite:
        """Add the current entries to the state spec, because a step reads them."""
        input_spec = cloned(input_spec)
        for key in self.in_keys:
            spec = read_spec(self, observed_specs(self), key)
            input_spec["full_state_spec"][key] = spec.clone()
        return input_spec
