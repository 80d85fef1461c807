"""Base class of transforms that carry the points of past scans from step to step."""

from __future__ import annotations

from abc import abstractmethod

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec

from navrl.checks import check_counts
from navrl.ops import se2
from navrl.transforms.observation_map import (
    Keys,
    cloned,
    nested_keys,
    observed_specs,
    read,
    read_spec,
    real_spec,
)
from navrl.transforms.stateful import StatefulTransform


class AlignedHistory(StatefulTransform):
    """Base class of transforms that read points of past scans in the current frame.

    As in :class:`navrl.transforms.ScanHistory` the past is stored in the TensorDict: a step reads
    the points and their past from the root and moves both to the frame at t. A subclass defines the
    points, the past after a reset, and the outputs.

    Args:
        in_keys: The entries of scan t, the first of them ``[*B, N, C]``, then at the index
            ``TRANSFORM`` T_target_source ``[*B, 3]`` (m, m, rad) of frame t-1 in frame t, then any.
        out_keys: The outputs; that at the index ``PAST`` is the past ``[*B, K, N, 2]`` m in
            frame t, scan t-1 first.
        num_scans: Number of past scans K.

    Raises:
        ValueError: If ``num_scans`` is not positive, or later if the environment lacks a key.
    """

    TRANSFORM: int
    PAST: int

    def __init__(self, in_keys: Keys, out_keys: Keys, num_scans: int) -> None:
        """Check the number of scans."""
        super().__init__(in_keys=nested_keys(in_keys), out_keys=nested_keys(out_keys))
        check_counts(num_scans=num_scans)
        self.num_scans = num_scans

    @abstractmethod
    def _latest(self, tensordict: TensorDictBase) -> Tensor:
        """Return the points of the current scan that are kept, ``[*B, N, 2]`` m."""

    @abstractmethod
    def _initial(self, tensordict: TensorDictBase) -> Tensor:
        """Return the past of the first scan of an episode, ``[*B, K, N, 2]`` m."""

    @abstractmethod
    def _write(self, tensordict: TensorDictBase, past: Tensor) -> TensorDictBase:
        """Write the outputs of the current scan and its past ``[*B, K, N, 2]`` m."""

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        older = read(self, tensordict, self.out_keys[self.PAST])[..., :-1, :, :]
        past = torch.cat([self._latest(tensordict).unsqueeze(-3), older], dim=-3)
        transform = read(self, next_tensordict, self.in_keys[self.TRANSFORM]).unsqueeze(-2)
        return self._write(next_tensordict, se2.transform_points(transform, past))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, self._initial(next_tensordict))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> Composite:
        """Add the spec of the past scans to those of the environment."""
        observation_spec = cloned(observation_spec)
        observation_spec[self.out_keys[self.PAST]] = self._past_spec(observation_spec)
        return observation_spec

    def transform_input_spec(self, input_spec: TensorSpec) -> Composite:
        """Add the current scan and its past to the state spec, because a step reads them."""
        input_spec = cloned(input_spec)
        observed, state = observed_specs(self), input_spec["full_state_spec"]
        for key in self.in_keys[: self.TRANSFORM]:
            state[key] = read_spec(self, observed, key).clone()
        state[self.out_keys[self.PAST]] = self._past_spec(observed)
        return input_spec

    def _past_spec(self, specs: Composite) -> TensorSpec:
        scan = read_spec(self, specs, self.in_keys[0])
        *batch, num_points, _ = scan.shape
        return real_spec(scan, *batch, self.num_scans, num_points, 2)
