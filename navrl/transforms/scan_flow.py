"""Velocity of every return of a scan, estimated by a trained network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn
from torchrl.data import TensorSpec

from navrl import keys
from navrl.checks import is_finite
from navrl.networks.scan_flow import load_scan_flow
from navrl.ops.returns import finite_returns
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec, real_spec


class EstimateFlow(ObservationMap):
    """Estimate the previous position of every return, from several aligned past scans.

    The outputs have the form of the descriptors of :class:`navrl.transforms.TAGD`, one for each
    return instead of one for each of a few directions, so :class:`navrl.transforms.ActionShield`
    reads either. The network is trained with the simulator's true velocities; it is not part of the
    policy, whose weights do not include it. What it estimates is the displacement from scan to
    scan, so the scans may be closer or farther apart in time than those of its training.

    Args:
        weights: File of :func:`navrl.networks.scan_flow.save_scan_flow`; ``None`` for the one in
            the package. A saved policy stores the path, not the file.
        threshold: Probability to move above which a return moves, between 0 and 1.
        in_keys: Points ``[*B, N, 2]`` m and returns ``[*B, N]`` bool of scan t, and the ranges
            ``[*B, K + 1, N]`` m of :class:`navrl.transforms.RangeHistory` with as many past scans
            K as the network has.
        out_keys: Previous and present position of each return ``[*B, N, 4]`` m in frame t, equal
            for a static one, and whether the point is a return ``[*B, N, 2]`` bool, twice.

    Raises:
        ValueError: If an argument is invalid, the weights cannot be loaded, or later if the shapes
            do not fit the network.

    Example:
        >>> flow = EstimateFlow()
        >>> points, no_returns = torch.ones(1, 180, 2), torch.zeros(1, 180, dtype=torch.bool)
        >>> ranges = torch.full((1, 6, 180), 3.5)
        >>> descriptors, valid = flow(points=points, returns=no_returns, flow_ranges=ranges)
        >>> descriptors.shape, bool(valid.any())
        (torch.Size([1, 180, 4]), False)

    Reference:
        Not in the paper; see :class:`navrl.networks.ScanFlow` for the network.
    """

    INPUTS = ("points", "returns", "ranges")
    OUTPUTS = ("descriptors", "valid")

    def __init__(
        self,
        weights: str | Path | None = None,
        threshold: float = 0.5,
        in_keys: Keys = (keys.POINTS, keys.RETURNS, keys.FLOW_RANGES),
        out_keys: Keys = (keys.FLOW, keys.FLOW_VALID),
    ) -> None:
        """Check the arguments and load the network."""
        super().__init__(in_keys, out_keys)
        if not (is_finite(threshold) and 0.0 < threshold < 1.0):
            raise ValueError(f"threshold={threshold!r}: must be between 0 and 1")
        self.threshold = threshold
        self.network = load_scan_flow(weights)
        _make_constant(self.network)

    @torch.no_grad()
    def map_values(self, points: Tensor, returns: Tensor, ranges: Tensor) -> Sequence[Tensor]:
        """Return the positions of each return and whether it is one."""
        returns = finite_returns(points, returns)
        now = torch.where(returns.unsqueeze(-1), points.float(), 0.0)
        with torch.autocast(points.device.type, enabled=False):
            moving, velocity = self.network(ranges.float(), returns)
        moves = returns & (moving.sigmoid() > self.threshold)
        ahead = now / now.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        left = torch.stack([-ahead[..., 1], ahead[..., 0]], dim=-1)
        displacement = self.network.time_step * (
            velocity[..., :1] * ahead + velocity[..., 1:] * left
        )
        previous = torch.where(moves.unsqueeze(-1), now - displacement, now)
        return torch.cat([previous, now], dim=-1), returns.unsqueeze(-1).repeat_interleave(2, -1)

    def map_specs(
        self, points: TensorSpec, returns: TensorSpec, ranges: TensorSpec
    ) -> Sequence[TensorSpec]:
        """Return the specs of positions and validity."""
        self.network.check_shapes(ranges.shape, returns.shape)
        return real_spec(points, *returns.shape, 4), flag_spec(points, *returns.shape, 2)


def _make_constant(network: nn.Module) -> None:
    """Turn parameters into buffers, which are neither trained nor saved.

    Args:
        network: Network, modified in place.
    """
    for module in network.modules():
        for name, value in [*module.named_parameters(recurse=False)]:
            delattr(module, name)
            module.register_buffer(name, value.detach(), persistent=False)
