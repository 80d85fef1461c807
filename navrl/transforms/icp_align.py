"""Alignment of the previous scan with the current robot frame."""

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
    """Align scan t-1 with scan t by scan matching, without odometry.

    Args:
        method: ``"icp"``, or ``"none"`` for the identity, which is the paper's robustness test with
            ICP turned off (not converged, no matches).
        initialization: ``"identity"`` or ``"rotation_search"``.
        metric: ``"point_to_point"`` or ``"point_to_line"``.
        gate: Largest distance of a match, m.
        robust_scale: Scale of the robust weight of the point-to-line stage, m; None for no weight.
        max_iterations: Largest number of iterations of each stage.
        rotation_tolerance: Rotation of a step below which a stage has converged, rad.
        translation_tolerance: Translation of a step below which a stage has converged, m.
        min_pairs: Required number of matches; with fewer the result is the identity.
        search_range: Largest rotation of the rotation search to either side, rad.
        in_keys: Points ``[*B, N, 2]`` m and returns ``[*B, N]`` bool of scan t-1, then of scan t;
            optionally the bins covered by the lidar ``[*B, N]`` bool, for the rotation search.
        out_keys: Points of scan t-1 in frame t ``[*B, N, 2]`` m, T_target_source ``[*B, 3]``,
            convergence ``[*B, 1]`` bool, number of matched pairs ``[*B, 1]`` int64.

    Raises:
        ValueError: If an argument is invalid; the message names it.

    Example:
        >>> scan = torch.tensor([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]).repeat(1, 4, 1)
        >>> is_return, moved = torch.ones(1, 12, dtype=torch.bool), torch.tensor([0.1, 0.0])
        >>> _, transform, converged, inliers = ICPAlign()(
        ...     points_previous=scan, returns_previous=is_return,
        ...     points=scan + moved, returns=is_return,
        ... )
        >>> transform.round(decimals=3).abs(), int(inliers)
        (tensor([[0.1000, 0.0000, 0.0000]]), 12)

    Reference:
        Paper Sec. IV-A; "ICP alignment artificially turned off" is tested in Sec. V-E. The options
        that the paper does not specify are described in :class:`navrl.ops.icp.IcpOptions`.
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
            raise ValueError(f"method={method!r}: must be one of icp, none")
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
        """Align the scans; see :func:`navrl.ops.icp.align`."""
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
        """Return the specs of aligned points, transform, convergence and inliers."""
        batch = points.shape[:-2]
        return (
            real_spec(points, *previous_points.shape),
            real_spec(points, *batch, 3),
            flag_spec(points, *batch, 1),
            Unbounded(torch.Size((*batch, 1)), dtype=torch.int64, device=points.device),
        )
