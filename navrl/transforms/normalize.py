"""Scale observations to about [-1, 1]."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded

from navrl import keys
from navrl.transforms.observation_map import Keys, ObservationMap, nested_keys


class Normalize(ObservationMap):
    """Divide entries by a common scale, so that values are in about [-1, 1].

    All entries share the scale, so points, descriptors and waypoints remain comparable.

    Args:
        scale: Value that is mapped to 1, in the unit of the entries, e.g. m; or a list with one
            value for each component of the last dimension, e.g. for (v, w).
        in_keys: Any number of entries in that unit, of any shape.
        out_keys: One network input key for each entry.

    Raises:
        ValueError: If a scale is not positive and finite, or the numbers of keys differ.

    Example:
        >>> normalize = Normalize(scale=3.5, in_keys=["goal_position"], out_keys=["goal_scaled"])
        >>> normalize(goal_position=torch.tensor([[3.5, -7.0]]))
        tensor([[ 1., -2.]])

    Reference:
        Not in the paper; the authors' precursor divides all coordinates by d_max = 3.5 m.
    """

    def __init__(
        self,
        scale: float | Sequence[float] = 3.5,
        in_keys: Keys = (keys.POINTS, keys.TAGD, keys.WAYPOINTS),
        out_keys: Keys = (keys.SPATIAL_INPUT, keys.TEMPORAL_INPUT, keys.WAYPOINTS_SCALED),
    ) -> None:
        self.INPUTS = tuple(map(str, nested_keys(in_keys)))
        self.OUTPUTS = self.INPUTS
        super().__init__(in_keys, out_keys)
        scales = list(scale) if isinstance(scale, Sequence) else [scale]
        if not scales or not all(0.0 < value < math.inf for value in scales):
            raise ValueError(f"scale={scale}: must be positive and finite")
        self.scale = scale if isinstance(scale, (int, float)) else tuple(scales)

    def map_values(self, *inputs: Tensor) -> Sequence[Tensor]:
        """Divide each input by the scale."""
        return [self._divided(value.float()) for value in inputs]

    def map_specs(self, *inputs: TensorSpec) -> Sequence[TensorSpec]:
        """Return the specs with scaled bounds, if they have bounds."""
        return [self._scaled(spec) for spec in inputs]

    def _scaled(self, spec: TensorSpec) -> TensorSpec:
        kind = {"dtype": torch.float32, "device": spec.device}
        if isinstance(spec, Bounded):
            low, high = spec.low.float(), spec.high.float()
            return Bounded(self._divided(low), self._divided(high), spec.shape, **kind)
        return Unbounded(spec.shape, **kind)

    def _divided(self, value: Tensor) -> Tensor:
        if isinstance(self.scale, (int, float)):
            return value / self.scale
        if value.shape[-1] != len(self.scale):
            raise ValueError(
                f"scale={list(self.scale)}: must be one number for each of the {value.shape[-1]} "
                f"components of {self.in_keys}"
            )
        return value / value.new_tensor(self.scale)
