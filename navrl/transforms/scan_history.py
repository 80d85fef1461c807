"""The previous scan, as a key."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import dispatch
from torchrl.data import Composite
from torchrl.envs import Transform

from navrl import keys
from navrl.transforms.observation_map import (
    Keys,
    map_reset_rows,
    nested_keys,
    read,
    read_spec,
    refuse_without_past,
)


class ScanHistory(Transform):
    """Carry entries of time t-1 beside those of time t.

    The past lives in the TensorDict, not here: the value at t-1 is read from the root that the
    caller steps. So partial resets, interleaved streams, planning and replay all see their own
    past. At a reset there is none, and the current value stands in for it: nothing has moved.

    Args:
        in_keys: Entries of time t, of any number and shape.
        out_keys: Keys for the same entries of time t-1, each in its own frame.

    Raises:
        ValueError: If there are not as many out_keys as in_keys, or later if the environment
            lacks one.

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
                f"ScanHistory: out_keys must be as many as in_keys ({self.in_keys}), "
                f"got {self.out_keys}"
            )

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for now, previous in zip(self.in_keys, self.out_keys, strict=True):
            # A clone: workers of a ParallelEnv overwrite the root's memory at the next step.
            next_tensordict.set(previous, read(self, tensordict, now).clone())
        return next_tensordict

    def _call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Let the present stand in for a past that does not exist."""
        for now, previous in zip(self.in_keys, self.out_keys, strict=True):
            tensordict.set(previous, read(self, tensordict, now).clone())
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return map_reset_rows(self, tensordict, tensordict_reset)

    @dispatch(source="in_keys", dest="out_keys", auto_batch_size=False)
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Restore the past of stored data.

        Under ``"next"`` it is the root's present, also at the end of an episode. At the root a
        stored past is kept. Without one, data without ``"next"`` is of first scans, for which the
        present stands in; a transition is refused.

        Raises:
            ValueError: If the root of a transition lacks its past.
        """
        missing = [key for key in self.out_keys if key not in tensordict.keys(True, True)]
        if missing:
            refuse_without_past(self, tensordict, missing)
            self._call(tensordict)
        if "next" in tensordict:
            self._step(tensordict, tensordict["next"])
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Return the environment's specs with those of the past added."""
        specs = [read_spec(self, observation_spec, key).clone() for key in self.in_keys]
        observation_spec = observation_spec.clone()
        for key, spec in zip(self.out_keys, specs, strict=True):
            observation_spec[key] = spec
        return observation_spec

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Declare that a step reads the present from its caller."""
        input_spec = input_spec.clone()
        for key in self.in_keys:
            spec = read_spec(self, self.parent.full_observation_spec, key)
            input_spec["full_state_spec"][key] = spec.clone()
        return input_spec
