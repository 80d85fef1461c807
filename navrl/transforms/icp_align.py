"""Alignment of the previous scan with the current robot frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from navrl import keys
from navrl.checks import check_positive
from navrl.ops import se2
from navrl.ops.icp import Alignment, align
from navrl.ops.icp_options import IcpOptions
from navrl.ops.icp_quality import align_from_prior, alignment_quality
from navrl.ops.unicycle import advance_poses
from navrl.transforms.observation_map import Keys, ObservationMap, flag_spec, real_spec

_SCAN_KEYS = {
    "previous points": keys.PREVIOUS_POINTS,
    "previous returns": keys.PREVIOUS_RETURNS,
    "points": keys.POINTS,
    "returns": keys.RETURNS,
}
_FULL_KEYS = {
    "full-range previous points": keys.PREVIOUS_POINTS_FULL,
    "full-range previous returns": keys.PREVIOUS_RETURNS_FULL,
    "full-range points": keys.POINTS_FULL,
    "full-range returns": keys.RETURNS_FULL,
}
_PRIOR_KEYS = {
    "none": {},
    "pose": {"previous pose": keys.PREVIOUS_POSE, "pose": keys.POSE},
    "pose_ahead": {"previous pose": keys.PREVIOUS_POSE, "pose": keys.POSE_AHEAD},
    "velocity": {"velocity": keys.VELOCITY},
}


class ICPAlign(ObservationMap):
    """Align scan t-1 with scan t by scan matching, by default without odometry.

    ``prior`` adds odometry, which starts the alignment and holds the directions that the scans
    leave free, ``full_range`` aligns scans of a farther range than that of the points, and a fifth
    output measures the quality of the result.

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
        prior: ``"none"``; ``"pose"``, the difference of two poses; ``"pose_ahead"``, of two poses
            of :class:`navrl.transforms.MotionPrediction`, for scans that are moved to these; or
            ``"velocity"``, the present (v, w) held for ``time_step_s``. A prior replaces the
            initialization.
        time_step_s: Time between two scans, s; only for ``prior="velocity"``.
        full_range: Whether the motion is estimated from four further keys, the scans at the range
            of the sensor. The aligned points remain those of the first four.
        min_eigenvalue: A direction is free if a smaller share of the returns constrains the motion
            along it, as along a corridor without ends; a prior is retained there. See
            :func:`navrl.ops.icp_quality.alignment_quality`.
        converged: ``"steps"``: the last step was small. ``"quality"``: the thresholds below are
            met too and, without a prior, ``min_eigenvalue`` in every direction.
        min_inlier_share: Smallest share of inliers, only for ``"quality"``.
        max_rms: Largest RMS residual of the inliers, m, only for ``"quality"``.
        in_keys: Points ``[*B, N, 2]`` m and returns ``[*B, N]`` bool of scan t-1, then of scan t;
            with ``full_range`` the same four at the full range; with a prior of poses these
            ``[*B, 3]`` (m, m, rad) at t-1 and t, with ``"velocity"`` the velocity ``[*B, 2]``;
            optionally the bins covered by the lidar ``[*B, N]`` bool, for the rotation search.
        out_keys: Points of scan t-1 in frame t ``[*B, N, 2]`` m, the pose (x, y, yaw) of the robot
            frame at t-1 in that at t ``[*B, 3]`` (m, m, rad), convergence ``[*B, 1]`` bool, number
            of matched pairs ``[*B, 1]`` int64; optionally the quality ``[*B, 4]``: share of
            inliers, their RMS residual in m, the two smallest eigenvalues.

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

    INPUTS = tuple(_SCAN_KEYS)
    OPTIONAL_INPUTS = ("seen",)
    OUTPUTS = ("aligned points", "transform", "converged", "inliers")
    OPTIONAL_OUTPUTS = ("quality",)

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
        prior: Literal["none", "pose", "pose_ahead", "velocity"] = "none",
        time_step_s: float = 0.2,
        full_range: bool = False,
        min_eigenvalue: float = 0.1,
        converged: Literal["steps", "quality"] = "steps",
        min_inlier_share: float = 0.8,
        max_rms: float = 0.035,
        in_keys: Keys | None = None,
        out_keys: Keys = (
            keys.ALIGNED_POINTS,
            keys.ICP_TRANSFORM,
            keys.ICP_CONVERGED,
            keys.ICP_INLIERS,
        ),
    ) -> None:
        if prior not in _PRIOR_KEYS:
            raise ValueError(f"prior={prior!r}: must be one of {', '.join(_PRIOR_KEYS)}")
        defaults = {**_SCAN_KEYS, **(_FULL_KEYS if full_range else {}), **_PRIOR_KEYS[prior]}
        self.INPUTS = tuple(defaults)
        super().__init__(tuple(defaults.values()) if in_keys is None else in_keys, out_keys)
        if method not in ("icp", "none"):
            raise ValueError(f"method={method!r}: must be one of icp, none")
        if converged not in ("steps", "quality"):
            raise ValueError(f"converged={converged!r}: must be one of steps, quality")
        check_positive(time_step_s=time_step_s, max_rms=max_rms)
        for name, value in (
            ("min_inlier_share", min_inlier_share),
            ("min_eigenvalue", min_eigenvalue),
        ):
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"{name}={value}: must be within 0..1")
        self.method, self.prior, self.time_step_s = method, prior, time_step_s
        self.full_range, self.min_eigenvalue = full_range, min_eigenvalue
        self.converged, self.min_inlier_share, self.max_rms = converged, min_inlier_share, max_rms
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
        *others: Tensor,
    ) -> Sequence[Tensor]:
        """Align the scans; see :func:`navrl.ops.icp.align`."""
        batch = points.shape[:-2]
        scans = (previous_points, previous_returns, points, returns)
        if self.full_range:
            scans, others = others[:4], others[4:]
        if self.method == "none":
            nothing = torch.zeros(batch, dtype=torch.int64, device=points.device)
            transform = points.new_zeros(*batch, 3)
            zeros = transform[..., 0]
            result = Alignment(transform, nothing.bool(), nothing, zeros, nothing)
            aligned = previous_points.clone()
        else:
            result = self._align(scans, others)
            aligned = se2.transform_points(result.transform, previous_points)
        outputs = [aligned, result.transform, result.converged, result.inliers.unsqueeze(-1)]
        has_quality = len(self.out_keys) > len(self.OUTPUTS)
        if has_quality or self.converged == "quality":
            quality = self._quality(result.transform, scans)
            outputs.append(quality)
            if self.converged == "quality":
                outputs[2] = result.converged & self._is_good(quality)
        outputs[2] = outputs[2].unsqueeze(-1)
        return outputs[: len(self.out_keys)]

    def _align(self, scans: Sequence[Tensor], others: Sequence[Tensor]) -> Alignment:
        source, source_returns, target, target_returns = scans
        count = len(self.INPUTS) - (8 if self.full_range else 4)
        if count == 0:
            seen = next(iter(others), None)
            return align(source, source_returns, target, target_returns, self.options, seen=seen)
        prior = self._motion(*others[:count]).to(target.dtype)
        settings = (self.options, self.min_eigenvalue)
        return align_from_prior(prior, source, source_returns, target, target_returns, *settings)

    def _motion(self, *odometry: Tensor) -> Tensor:
        """Return T_target_source ``[*B, 3]`` by odometry, in float64."""
        if self.prior != "velocity":
            before, now = (pose.double() for pose in odometry)
            return se2.relative(now, before)
        velocity = odometry[0].double()
        start = torch.zeros(*velocity.shape[:-1], 3, dtype=velocity.dtype, device=velocity.device)
        return se2.inverse(advance_poses(start, velocity, self.time_step_s))

    def _quality(self, transform: Tensor, scans: Sequence[Tensor]) -> Tensor:
        source, source_returns, target, target_returns = scans
        found = alignment_quality(
            transform, source, source_returns, target, target_returns, self.options
        )
        values = (found.inlier_share, found.rms, *found.eigenvalues.unbind(-1)[:2])
        return torch.stack(values, dim=-1)

    def _is_good(self, quality: Tensor) -> Tensor:
        share, rms, eigenvalue, _ = quality.unbind(-1)
        is_good = (share >= self.min_inlier_share) & (rms <= self.max_rms)
        if self.prior == "none":
            is_good &= eigenvalue >= self.min_eigenvalue
        return is_good

    def map_specs(
        self,
        previous_points: TensorSpec,
        previous_returns: TensorSpec,
        points: TensorSpec,
        returns: TensorSpec,
        *others: TensorSpec,
    ) -> Sequence[TensorSpec]:
        """Return the specs of aligned points, transform, convergence, inliers and quality."""
        batch = points.shape[:-2]
        specs = (
            real_spec(points, *previous_points.shape),
            real_spec(points, *batch, 3),
            flag_spec(points, *batch, 1),
            Unbounded(torch.Size((*batch, 1)), dtype=torch.int64, device=points.device),
            real_spec(points, *batch, 4),
        )
        return specs[: len(self.out_keys)]
