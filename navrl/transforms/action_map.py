"""Base class of action transforms."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs import Transform

from navrl.transforms.observation_map import (
    Keys,
    cloned,
    nested_keys,
    observed_specs,
    read,
    read_spec,
)


class ActionMap(Transform):
    """Base class of transforms that map a policy's action and observations to a command (v, w).

    As a step of the pipeline the transform is part of training, evaluation, policy bundles and
    deployment, where ``inv`` applies it. Stored data is not changed, because it holds the policy's
    own action. Subclasses implement :meth:`command`.

    Args:
        names: Descriptions of the entries of ``scan_keys``, for error messages.
        scan_keys: Keys of the observations read together with the action.
        action_key: Key of the action, on both sides of the transform.

    Raises:
        ValueError: If the number of keys is wrong, or later if a key is missing.
    """

    invertible = True

    def __init__(
        self, names: Sequence[str], scan_keys: Keys, action_key: NestedKey | list[str]
    ) -> None:
        action_keys = nested_keys([action_key])
        super().__init__(
            in_keys=[], out_keys=[], in_keys_inv=action_keys, out_keys_inv=list(action_keys)
        )
        self.scan_keys = nested_keys(scan_keys)
        if len(self.scan_keys) != len(names):
            raise ValueError(
                f"scan_keys={self.scan_keys}: must be {len(names)} keys ({', '.join(names)})"
            )

    def command(self, action: Tensor, *seen: Tensor) -> Tensor:
        """Return the commands ``[*B, 2]``, m/s and rad/s.

        Args:
            action: ``[*B, 2]``, action of the policy.
            seen: ``[*B, ...]``, entries of ``scan_keys``.
        """
        raise NotImplementedError

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = read(self, tensordict, self.out_keys_inv[0])
        seen = (read(self, tensordict, key) for key in self.scan_keys)
        return tensordict.set(self.in_keys_inv[0], self.command(action, *seen))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return stored data unchanged, because it holds the policy's own action."""
        return tensordict

    def transform_input_spec(self, input_spec: TensorSpec) -> Composite:
        """Add the scan keys to the state spec, because a step reads them.

        Raises:
            ValueError: If the environment lacks a key or its action is not (v, w).
        """
        input_spec = cloned(input_spec)
        for key in self.scan_keys:
            spec = read_spec(self, observed_specs(self), key)
            input_spec["full_state_spec"][key] = spec.clone()
        command = read_spec(self, input_spec["full_action_spec"], self.in_keys_inv[0])
        if command.shape[-1:] != (2,):
            raise ValueError(
                f"{type(self).__name__}: {self.in_keys_inv[0]!r} must be (v, w) [*B, 2], "
                f"got {tuple(command.shape)}"
            )
        return input_spec
