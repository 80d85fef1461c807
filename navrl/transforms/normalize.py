"""Scale lengths to about [-1, 1]."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded

from navrl import keys
from navrl.transforms.observation_map import Keys, ObservationMap, nested_keys


class Normalize(ObservationMap):
    """Divide entries by a common length, so that coordinates are in about [-1, 1].

    All entries share the scale, so points, descriptors and waypoints remain comparable.

    Args:
        scale: Length that is mapped to 1, m.
        in_keys: Any number of entries in m, of any shape.
        out_keys: One network input key for each entry.

    Raises:
        ValueError: If the scale is not positive or the numbers of keys differ.

    Example:
        >>> normalize = Normalize(scale=3.5, in_keys=["goal_position"], out_keys=["goal_scaled"])
        >>> normalize(goal_position=torch.tensor([[3.5, -7.0]]))
        tensor([[ 1., -2.]])

    Reference:
        Not in the paper; the authors' precursor divides all coordinates by d_max = 3.5 m.
    """

    def __init__(
        self,
        scale: float = 3.5,
        in_keys: Keys = (keys.POINTS, keys.TAGD, keys.WAYPOINTS),
        out_keys: Keys = (keys.SPATIAL_INPUT, keys.TEMPORAL_INPUT, keys.WAYPOINTS_SCALED),
    ) -> None:
        self.INPUTS = tuple(map(str, nested_keys(in_keys)))
        self.OUTPUTS = self.INPUTS
        super().__init__(in_keys, out_keys)
        if not scale > 0.0:
            raise ValueError(f"scale={scale}: must be positive (m)")
        self.scale = scale

    def map_values(self, *inputs: Tensor) -> Sequence[Tensor]:
        """Divide each input by the scale."""
        return [value.float() / self.scale for value in inputs]

    def map_specs(self, *inputs: TensorSpec) -> Sequence[TensorSpec]:
        """Return the specs with scaled bounds, if they have bounds."""
        return [self._scaled(spec) for spec in inputs]

    def _scaled(self, spec: TensorSpec) -> TensorSpec:
        kind = {"dtype": torch.float32, "device": spec.device}
        if isinstance(spec, Bounded):
            low, high = spec.low.float(), spec.high.float()
            return Bounded(low / self.scale, high / self.scale, spec.shape, **kind)
        return Unbounded(spec.shape, **kind)
