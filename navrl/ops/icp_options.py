"""Options of the scan alignment, shared by the kernel and the torch reference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from navrl.checks import check_counts

SLIDE_WEIGHT = 0.01  # weight of the residual along a line; keeps an endless corridor well posed
DAMPING = 1e-6  # added to the normal equations so that degenerate scans remain solvable


@dataclass(frozen=True)
class IcpOptions:
    """Settings of :func:`navrl.ops.icp.align`; the defaults are the plain ICP of the paper.

    Args:
        initialization: ``"identity"`` starts from no motion. ``"rotation_search"`` first correlates
            the range profiles of the two scans, which must be ordered by bearing, evenly spaced and
            of equal length.
        metric: ``"point_to_point"`` minimizes distances between matched points.
            ``"point_to_line"`` continues from that result and minimizes distances to the line
            through each target point and its neighbors; the target must be ordered by bearing.
        gate: Largest distance of a match, m; farther pairs are rejected.
        robust_scale: Scale of the Geman-McClure weight ``1 / (1 + (r / scale)^2)^2`` of the
            point-to-line stage, m, by which moving obstacles are down-weighted as outliers. None
            gives all matches equal weight.
        max_iterations: Largest number of iterations of each stage.
        rotation_tolerance: A stage has converged when a step rotates by less than this, rad, and
            translates by less than ``translation_tolerance``.
        translation_tolerance: See ``rotation_tolerance``, m.
        min_pairs: With fewer matches the alignment fails: identity, not converged.
        search_range: Largest rotation of the rotation search to either side, rad.

    Raises:
        ValueError: If an option is invalid; the message names it.

    Reference:
        Paper Sec. IV-A, least-squares ICP (Arun et al. 1987), whose settings the paper does not
        give; the defaults are those of the authors' precursor.
    """

    initialization: Literal["identity", "rotation_search"] = "identity"
    metric: Literal["point_to_point", "point_to_line"] = "point_to_point"
    gate: float = 1.05
    robust_scale: float | None = 0.05
    max_iterations: int = 100
    rotation_tolerance: float = 1e-4
    translation_tolerance: float = 3.5e-3
    min_pairs: int = 10
    search_range: float = 0.7

    def __post_init__(self) -> None:
        allowed = {
            "initialization": ("identity", "rotation_search"),
            "metric": ("point_to_point", "point_to_line"),
        }
        for name, values in allowed.items():
            if getattr(self, name) not in values:
                raise ValueError(
                    f"{name}={getattr(self, name)!r}: must be one of {', '.join(values)}"
                )
        check_counts(max_iterations=self.max_iterations, min_pairs=self.min_pairs)
        positive = ["gate", "rotation_tolerance", "translation_tolerance"]
        positive += ["search_range"] + ([] if self.robust_scale is None else ["robust_scale"])
        for name in positive:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}={getattr(self, name)}: must be positive")
        if self.min_pairs < 2:
            raise ValueError(f"min_pairs={self.min_pairs}: must be at least 2")
        if self.search_range > math.pi:
            raise ValueError(f"search_range={self.search_range}: must be at most pi rad")


PAPER = IcpOptions()
ROBUST = IcpOptions(initialization="rotation_search", metric="point_to_line", gate=0.3)
