"""Options of the scan alignment, shared by its kernel and its reference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

SLIDE_WEIGHT = 0.01  # of the residual along a line: keeps a corridor without end well posed
DAMPING = 1e-6  # keeps the normal equations solvable when the points say nothing


@dataclass(frozen=True)
class IcpOptions:
    """How :func:`navrl.ops.icp.align` works; the defaults are the plain ICP of the paper's method.

    Args:
        initialization: ``"identity"`` starts from no motion. ``"rotation_search"`` first turns the
            range profile of one scan over the other, which needs both scans to be ordered by
            bearing, evenly spaced, and of as many points.
        metric: ``"point_to_point"`` minimises distances between matched points.
            ``"point_to_line"`` continues from there, minimising distances to the line through
            each target point and its neighbours, which needs the target ordered by bearing.
        gate: Matches farther apart than this are not used, m.
        robust_scale: Scale of the Geman-McClure weight ``1 / (1 + (r / scale)^2)^2`` of the
            point-to-line stage, m: what moves loses its say. None weighs all matches alike.
        max_iterations: Bound on the iterations of each stage.
        rotation_tolerance: A stage has converged when a step turns less than this, rad, and
        translation_tolerance: moves less than this, m.
        min_pairs: With fewer matches the alignment has failed: identity, not converged.
        search_range: Largest turn the rotation search considers to either side, rad.

    Raises:
        ValueError: If an option is not as above, naming it.

    Reference:
        Paper Sec. IV-A, ICP by least squares (Arun et al. 1987), its settings left open; the
        defaults are those of the authors' precursor.
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
                    f"{name} must be one of {', '.join(values)}, got {getattr(self, name)!r}"
                )
        positive = ["gate", "max_iterations", "rotation_tolerance", "translation_tolerance"]
        positive += ["search_range"] + ([] if self.robust_scale is None else ["robust_scale"])
        for name in positive:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if self.min_pairs < 2:
            raise ValueError(f"min_pairs must be at least 2, got {self.min_pairs}")
        if self.search_range > math.pi:
            raise ValueError(f"search_range must be at most pi rad, got {self.search_range}")


PAPER = IcpOptions()
ROBUST = IcpOptions(initialization="rotation_search", metric="point_to_line", gate=0.3)
