"""Shapes that show a policy's attention and group descriptors, for markers of ROS."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navrl.deploy.control_status import ControlStatus

ARROW, SPHERE_LIST, POINTS = 0, 7, 8
"""Codes of visualization_msgs/Marker."""

_ORANGE, _BLUE, _GRAY = (0.9, 0.4, 0.0), (0.0, 0.45, 0.7), (0.5, 0.5, 0.5)


class Shape(NamedTuple):
    """One marker in the robot frame."""

    kind: str
    code: int
    points: np.ndarray
    """``[P, 2]`` m."""
    size: tuple[float, float, float]
    """Scale of the marker, m."""
    color: tuple[float, float, float, float]
    """Red, green, blue, opacity in [0, 1]."""


def attention_spheres(status: ControlStatus) -> list[Shape]:
    """Return the returns of the scan, and a sphere in each sector by its spatial attention."""
    if status.points is None or status.returns is None:
        return []
    shapes = [
        Shape("scan", POINTS, status.points[status.returns], (0.03, 0.03, 0.03), (*_GRAY, 1.0))
    ]
    weights = status.spatial_attention
    if weights is None or len(status.points) % len(weights):
        return shapes
    groups = status.points.reshape(len(weights), -1, 2)
    nearest = np.hypot(groups[..., 0], groups[..., 1]).argmin(1)
    for weight, place in zip(weights, groups[np.arange(len(weights)), nearest], strict=True):
        share = float(min(1.0, weight * len(weights) / 3.0))  # three times the mean is full
        color = (*_ORANGE, max(0.05, share))
        shapes.append(Shape("attention", SPHERE_LIST, place[None], (0.15, 0.15, 0.15), color))
    return shapes


def group_arrows(status: ControlStatus) -> list[Shape]:
    """Return an arrow from the past to the present centroid of each group with points."""
    if status.tagd is None or status.tagd_valid is None:
        return []
    rows = status.tagd[status.tagd_valid.all(-1)].reshape(-1, 2, 2)
    return [Shape("tagd", ARROW, row, (0.03, 0.06, 0.06), (*_BLUE, 1.0)) for row in rows]
