"""The previous scan, seen from where the robot is now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from navrl import keys
from navrl.ops import se2
from navrl.ops.icp import align
from navrl.ops.icp_options import IcpOptions
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec, real_spec


class ICPAlign(ObservationMap):
    """Align scan t-1 to scan t, from the scans alone: no odometry.

    Args:
        method: ``"icp"``, or ``"none"`` for the identity: the paper's robustness test with ICP
            turned off, where nothing converges and nothing matches.
        initialization: ``"identity"`` or ``"rotation_search"``.
        metric: ``"point_to_point"`` or ``"point_to_line"``.
        gate: Matches farther apart than this are not used, m.
        robust_scale: Scale of the point-to-line stage's robust weight, m; None for none.
        max_iterations: Bound on the iterations of each stage.
        rotation_tolerance: Turn of a step below which it has converged, rad.
        translation_tolerance: Motion of a step below which it has converged, m.
        min_pairs: Matches that an alignment needs; with fewer it is the identity.
        search_range: Largest turn the rotation search considers to either side, rad.
        in_keys: Points ``[*B, N, 2]`` m and returns ``[*B, N]`` bool of scan t-1, then of scan t;
            optionally the bins that the lidar covers ``[*B, N]`` bool, for the rotation search.
        out_keys: Points of scan t-1 in frame t ``[*B, N, 2]`` m, T_target_source ``[*B, 3]``,
            whether it converged ``[*B, 1]`` bool, matched pairs ``[*B, 1]`` int64.

    Raises:
        ValueError: If an argument is not as above, naming it.

    Reference:
        Paper Sec. IV-A; "ICP alignment artificially turned off" is tested in Sec. V-E. The options
        and what the paper leaves open are described in :class:`navrl.ops.icp.IcpOptions`.
    """

    INPUTS = ("previous points", "previous returns", "points", "returns")
    OPTIONAL_INPUTS = ("seen",)
    OUTPUTS = ("aligned points", "transform", "converged", "inliers")

    def __init__(
        self,
        method: Literal["icp", "none"] = "icp",
        initialization: Literal["identity", "rotation_search"] = "identity",
        metric: Literal["point_to_point", "point_to_line"] = "point_to_point",
        gate: float = 1.05,
        robust_scale: float | None = 0.05,
        max_iterations: int = 100,
        rotation_tolerance: float = 1e-4,
        translation_tolerance: float = 3.5e-3,
        min_pairs: int = 10,
        search_range: float = 0.7,
        in_keys: Keys = (
            keys.PREVIOUS_POINTS,
            keys.PREVIOUS_RETURNS,
            keys.POINTS,
            keys.RETURNS,
        ),
        out_keys: Keys = (
            keys.ALIGNED_POINTS,
            keys.ICP_TRANSFORM,
            keys.ICP_CONVERGED,
            keys.ICP_INLIERS,
        ),
    ) -> None:
        super().__init__(in_keys, out_keys)
        if method not in ("icp", "none"):
            raise ValueError(f"method must be one of icp, none, got {method!r}")
        self.method = method
        self.options = IcpOptions(
            initialization=initialization,
            metric=metric,
            gate=gate,
            robust_scale=robust_scale,
            max_iterations=max_iterations,
            rotation_tolerance=rotation_tolerance,
            translation_tolerance=translation_tolerance,
            min_pairs=min_pairs,
            search_range=search_range,
        )

    def map_values(
        self,
        previous_points: Tensor,
        previous_returns: Tensor,
        points: Tensor,
        returns: Tensor,
        seen: Tensor | None = None,
    ) -> Sequence[Tensor]:
        """Align; see :func:`navrl.ops.icp.align`."""
        if self.method == "none":
            batch = points.shape[:-2]
            return (
                previous_points.clone(),
                points.new_zeros(*batch, 3),
                returns.new_zeros(*batch, 1),
                torch.zeros(*batch, 1, dtype=torch.int64, device=points.device),
            )
        scans = (previous_points, previous_returns, points, returns)
        result = align(*scans, self.options, seen=seen)
        return (
            se2.transform_points(result.transform, previous_points),
            result.transform,
            result.converged.unsqueeze(-1),
            result.inliers.unsqueeze(-1),
        )

    def map_specs(
        self,
        previous_points: TensorSpec,
        previous_returns: TensorSpec,
        points: TensorSpec,
        returns: TensorSpec,
        seen: TensorSpec | None = None,
    ) -> Sequence[TensorSpec]:
        """Return the specs of aligned points, transform, converged and inliers."""
        batch = points.shape[:-2]
        return (
            real_spec(points, *previous_points.shape),
            real_spec(points, *batch, 3),
            flag_spec(points, *batch, 1),
            Unbounded((*batch, 1), dtype=torch.int64, device=points.device),
        )
