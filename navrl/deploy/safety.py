"""Safety checks of scan, pose, path and command before a robot drives.

A policy cannot report that its input is unusable: on a scan without returns it commands full
speed. So its input and its command are checked separately.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import torch

from navrl.checks import check_angles, is_real
from navrl.ops.beams import RETURN_MARGIN_M
from navrl.ops.path import project_onto_path
from navrl.sim import Lidar, RobotModel


class DriveState(StrEnum):
    """State of a runner or controller; in every state but ``DRIVE`` the command is zero.

    - ``DRIVE``: the policy's command, within the robot's limits.
    - ``AT_GOAL``: the robot is within the goal radius of the path's last point.
    - ``OFF_PATH``: the robot is farther from its path than the policy was trained for.
    - ``BLOCKED``: an obstacle ahead is closer than the lidar's minimum range.
    - ``BLIND``: the scan does not cover the sector ahead, or no beam shows that the lidar works.
    - ``BAD_COMMAND``: the policy's command is not finite, or its computation failed.

    Only of :class:`navrl.deploy.Controller`:

    - ``EMERGENCY_STOP``: the emergency stop was requested and not released.
    - ``NO_PATH``: there is no path.
    - ``STALE_SCAN``: there is no scan, or its stamp is too old or in the future.
    - ``STALE_POSE``: there is no pose, or its stamp is too old or in the future.
    """

    DRIVE = "drive"
    AT_GOAL = "at_goal"
    OFF_PATH = "off_path"
    BLOCKED = "blocked"
    BLIND = "blind"
    BAD_COMMAND = "bad_command"
    EMERGENCY_STOP = "emergency_stop"
    NO_PATH = "no_path"
    STALE_SCAN = "stale_scan"
    STALE_POSE = "stale_pose"


@dataclass(frozen=True)
class SafetyLimits:
    """Conditions under which a robot may drive.

    Args:
        goal_radius: Distance to the path's last point at which the robot has arrived, m. 0.2:
            paper Sec. V-A, as in training.
        max_path_distance: Largest distance to the path, m. 2.0: the shipped policies stay within
            1.6 m in simulation.
        min_measured_share: Share of the beams that must measure a distance; with fewer the lidar
            counts as defective. 0.01: a single person 3 m away covers 0.02 of the beams. A scan
            without any return is the same in an empty place as from a defective lidar, so the robot
            stops there; use 0 to drive on, if the lidar is monitored by other means.
        max_gap: Widest gap of neighboring invalid beams ahead, rad. 0.175 (10 deg): beyond 2 m it
            can hide an obstacle as wide as the robot.
        sector: Half angle of the sector ahead, rad; also behind, if the robot may reverse.
        sensor_range: Largest distance a lidar can measure, m; a larger reading is invalid, unless
            it is the scan's maximum, which many drivers write for no return. 100: more than planar
            lidars measure, and 10 cm if ranges are in mm.

    Raises:
        ValueError: If a value is outside of its range.
    """

    goal_radius: float = 0.2
    max_path_distance: float = 2.0
    min_measured_share: float = 0.01
    max_gap: float = 0.175
    sector: float = 0.5 * math.pi
    sensor_range: float = 100.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not is_real(value):
                raise ValueError(f"{name}={value!r}: must be a number")
        for name in ("max_path_distance", "sector", "sensor_range"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name}={getattr(self, name)}: must be positive")
        check_angles(max_gap=self.max_gap, sector=self.sector)
        for name in ("goal_radius", "max_gap"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name}={getattr(self, name)}: must be >= 0")
        if not 0.0 <= self.min_measured_share <= 1.0:
            raise ValueError(f"min_measured_share={self.min_measured_share}: must be in [0, 1]")

    @classmethod
    def simulated(cls) -> SafetyLimits:
        """Return limits for simulated scans: every beam works, so an empty scan is free space.

        The distance to the path is not limited either, as in training.
        """
        return cls(max_path_distance=math.inf, min_measured_share=0.0)


class ScanCheck:
    """Classify the beams of a lidar's scans, and the scan as usable or not.

    A beam is one of (REP 117 of ROS, and the codes of common drivers):

    - a *distance*: finite and positive;
    - *no return*, free up to the largest range: positive infinity, zero, or the scan's maximum, if
      that is at least ``max_range``;
    - *too close*: negative infinity;
    - *invalid*: NaN, negative, or larger than ``sensor_range``.

    Beams that are blind in all episodes of the training (:class:`navrl.sim.coverage.Coverage`) may
    read anything, and those outside of the smallest field of view may be invalid. A lidar without
    a beam straight ahead is blind, and so is one with a blind sector ahead wider than ``max_gap``.

    Args:
        lidar: Number of beams, largest range, and mount of the scans.
        robot: Its radius, and the bearings that it drives towards.
        limits: Limits for a blind scan.
    """

    def __init__(self, lidar: Lidar, robot: RobotModel, limits: SafetyLimits) -> None:
        self._limits = limits
        self._max_range, self._radius = np.float32(lidar.max_range), np.float32(robot.radius)
        bearing = lidar.beam_angles().numpy() + lidar.mount[2]
        sides = robot.travel_bearings
        coverage, seed = lidar.coverage, torch.zeros(1, dtype=torch.int64)
        in_view, self._required = (
            mask.numpy() for mask in (coverage.in_smallest_view(), coverage.in_all_episodes())
        )
        self._covered = in_view & ~self._required
        drawn = torch.ones(lidar.num_beams, dtype=torch.bool)
        self._usable = (coverage.measured(seed)[0] if coverage.is_fixed else drawn).numpy()
        sectors = [_beams_within(bearing, side, limits.sector) for side in sides]
        self._sectors = [sector[in_view[sector]] for sector in sectors]
        self._max_gap_beams = limits.max_gap / abs(lidar.increment)
        gap = max(limits.max_gap, abs(lidar.increment))
        ahead = min(sides, key=abs, default=0.0)
        self._sees_ahead = bool(self._required[_beams_within(bearing, ahead, gap)].any())

    def state(self, ranges: np.ndarray) -> DriveState:
        """Return ``BLIND``, ``BLOCKED`` or ``DRIVE`` for a scan ``[num_beams]`` m."""
        measured, invalid = self._measured(ranges), self._invalid(ranges) | self._covered
        share = self._limits.min_measured_share
        if not self._sees_ahead or measured[self._required].mean() < share:
            return DriveState.BLIND
        if invalid.any():
            widest = max(_longest_run(invalid[sector]) for sector in self._sectors)
            if widest > self._max_gap_beams:
                return DriveState.BLIND
        too_near = np.isneginf(ranges) & self._usable
        if any(too_near[sector].any() for sector in self._sectors):
            return DriveState.BLOCKED
        return DriveState.DRIVE

    def cleaned(self, ranges: np.ndarray) -> np.ndarray:
        """Return the scan ``[num_beams]`` m as a simulated lidar would give it, float32.

        No return, invalid and blind become ``max_range``; too close becomes the robot's radius.
        """
        is_return = (ranges > 0.0) & (ranges <= self._max_range) & self._usable
        cleaned = np.where(is_return, ranges, self._max_range)
        return np.where(np.isneginf(ranges) & self._usable, self._radius, cleaned)

    def usable(self, ranges: np.ndarray) -> np.ndarray:
        """Return ``[num_beams]`` bool, the beams that are neither blind nor invalid."""
        return self._usable & ~self._invalid(ranges)

    def _invalid(self, ranges: np.ndarray) -> np.ndarray:
        impossible = (ranges > self._limits.sensor_range) & (ranges < _largest(ranges))
        return np.isnan(ranges) | ((ranges < 0.0) & ~np.isneginf(ranges)) | impossible

    def _measured(self, ranges: np.ndarray) -> np.ndarray:
        """Return ``[num_beams]`` bool: a distance, below or above the policy's maximum range."""
        in_range = (ranges > 0.0) & (ranges < self._max_range - RETURN_MARGIN_M)
        beyond = (ranges > self._max_range) & (ranges < _largest(ranges))
        return in_range | (beyond & (ranges <= self._limits.sensor_range))


def path_state(pose: np.ndarray, path: np.ndarray, limits: SafetyLimits) -> DriveState:
    """Return ``AT_GOAL``, ``OFF_PATH`` or ``DRIVE`` for the robot's position.

    Args:
        pose: ``[3]`` float64 (x, y, yaw), m and rad.
        path: ``[P, 2]`` float64 m, in the same frame.
        limits: Radius of the goal and largest distance to the path.
    """
    relative = path - pose[:2]
    if np.hypot(*relative[-1]) <= limits.goal_radius:
        return DriveState.AT_GOAL
    segments = np.concatenate([relative, relative[-1:]])  # a path of one point has none
    with np.errstate(over="ignore"):
        segments = torch.from_numpy(segments.astype(np.float32))
    distance = float(project_onto_path(segments, segments.new_zeros(2)).distance)
    return DriveState.DRIVE if distance <= limits.max_path_distance else DriveState.OFF_PATH


def safe_command(command: np.ndarray, robot: RobotModel) -> np.ndarray | None:
    """Return the command within the robot's limits, or ``None`` if it is not finite.

    Args:
        command: ``[C]`` float32, e.g. (v, w) in m/s and rad/s.
        robot: Its limits.
    """
    if not np.isfinite(command).all():
        return None
    low, high = (np.asarray(limit, dtype=np.float32) for limit in robot.command_limits)
    return np.clip(command, low, high)


def _beams_within(bearing: np.ndarray, center: float, half_angle: float) -> np.ndarray:
    """Return the indices of the beams around ``center``, in the order of their bearing."""
    offset = (bearing - center + math.pi) % (2.0 * math.pi) - math.pi
    order = np.argsort(offset, kind="stable")
    return order[np.abs(offset[order]) <= half_angle + 1e-9]


def _longest_run(flags: np.ndarray) -> int:
    """Return the length of the longest run of neighbors that are true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _largest(ranges: np.ndarray) -> np.floating:
    """Return the largest finite reading, m; zero if there is none."""
    return np.max(ranges, where=np.isfinite(ranges), initial=0.0)
