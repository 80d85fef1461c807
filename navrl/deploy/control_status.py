"""Command and status of a controller after a tick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from tensordict import TensorDictBase

from navrl import keys
from navrl.deploy.safety import DriveState


class Command(NamedTuple):
    """Result of a tick."""

    v: float
    """Forward speed, m/s; zero unless :attr:`state` is ``DRIVE``."""
    w: float
    """Turn rate, rad/s, counter-clockwise; zero unless :attr:`state` is ``DRIVE``."""
    state: DriveState


_ARRAYS = {
    "points": keys.POINTS,
    "returns": keys.RETURNS,
    "tagd": keys.TAGD,
    "tagd_valid": keys.TAGD_VALID,
    "spatial_attention": keys.SPATIAL_ATTENTION,
    "temporal_attention": keys.TEMPORAL_ATTENTION,
    "icp_transform": keys.ICP_TRANSFORM,
    "icp_quality": keys.ICP_QUALITY,
}


@dataclass(frozen=True)
class ControlStatus:
    """State of a controller after a tick; values that a policy does not compute are ``None``.

    Args:
        stamp: Time of the tick, s.
        command: Command and state.
        reason: Reason of the state, in words.
        scan_age_s: Age of the last beam of the latest scan, s; inf without one.
        pose_age_s: Age of the latest odometry or pose, s; inf without one.
        pose: ``[3]`` (x, y, yaw) of the robot in the path's frame, m and rad.
        progress_m: Arc length along the path, m.
        goal_distance_m: Distance to the path's last point, m.
        num_steps: Decisions of the policy since the start.
        num_thinned: Scans that were replaced by a newer one before a decision.
        num_rejected: Inputs that were refused, with an error or for their stamp.
        num_resets: Times that the scan history restarted after a gap.
        points: ``[N, 2]`` m, scan in the robot frame of the last decision.
        returns: ``[N]`` bool, the point is a return.
        tagd: ``[G, 4]`` m, group centroids before and now, robot frame.
        tagd_valid: ``[G, 2]`` bool, whether the group had and has points.
        spatial_attention: ``[S]`` weights with sum 1.
        temporal_attention: ``[G]`` weights with sum 1.
        icp_transform: ``[3]`` (x, y, yaw) of the last scan's frame in the present one, m and rad.
        icp_quality: ``[4]``, see :class:`navrl.transforms.ICPAlign`.
        icp_converged: Whether the alignment converged.
        icp_inliers: Number of matched pairs.
    """

    stamp: float
    command: Command
    reason: str
    scan_age_s: float
    pose_age_s: float
    pose: np.ndarray | None = None
    progress_m: float | None = None
    goal_distance_m: float | None = None
    num_steps: int = 0
    num_thinned: int = 0
    num_rejected: int = 0
    num_resets: int = 0
    points: np.ndarray | None = None
    returns: np.ndarray | None = None
    tagd: np.ndarray | None = None
    tagd_valid: np.ndarray | None = None
    spatial_attention: np.ndarray | None = None
    temporal_attention: np.ndarray | None = None
    icp_transform: np.ndarray | None = None
    icp_quality: np.ndarray | None = None
    icp_converged: bool | None = None
    icp_inliers: int | None = None

    @property
    def state(self) -> DriveState:
        """State of the last tick."""
        return self.command.state


def observed(observation: TensorDictBase | None) -> dict[str, Any]:
    """Return the arguments of :class:`ControlStatus` that an observation ``[1, ...]`` holds."""
    if observation is None:
        return {}
    values: dict[str, Any] = {
        name: observation[key][0].numpy() for name, key in _ARRAYS.items() if key in observation
    }
    for name, key in (
        ("icp_converged", keys.ICP_CONVERGED),
        ("icp_inliers", keys.ICP_INLIERS),
        ("progress_m", keys.PATH_PROGRESS),
    ):
        if key in observation:
            values[name] = observation[key].item()
    return values
