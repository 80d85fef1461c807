"""Checks of scan, pose and command as part of an exported graph."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor, nn

from navrl.deploy.safety import DriveState, SafetyLimits, ScanCheck
from navrl.ops.beams import RETURN_MARGIN_M
from navrl.ops.path import project_onto_path
from navrl.sim import Lidar, RobotModel

STATES = tuple(DriveState)
"""States by their number in the graph's output ``drive_state``."""
_NOT_STORED = (DriveState.OFF_PATH, DriveState.BLIND, DriveState.BAD_COMMAND)
_MAX_YAW = 2.0 * math.pi  # rad


class Guard(nn.Module):
    """The checks of :class:`navrl.deploy.PolicyRunner` on tensors ``[B, ...]``.

    Args:
        lidar: Number of beams, largest range, and mount of the scans.
        robot: Its radius, and the bearings that it drives towards.
        limits: Conditions under which the robot may drive.
    """

    def __init__(self, lidar: Lidar, robot: RobotModel, limits: SafetyLimits) -> None:
        """Take the beams of each check from :class:`navrl.deploy.ScanCheck`."""
        super().__init__()
        check = ScanCheck(lidar, robot, limits)
        self._limits, self._max_range, self._radius = limits, lidar.max_range, robot.radius
        self._sees_ahead, self._max_gap_beams = check._sees_ahead, check._max_gap_beams
        self._sectors = [torch.from_numpy(np.array(sector)) for sector in check._sectors]
        self._masks = [
            torch.from_numpy(np.array(mask))
            for mask in (check._required, check._covered, check._usable)
        ]

    def cleaned(self, ranges: Tensor) -> Tensor:
        """Return :meth:`navrl.deploy.ScanCheck.cleaned`, ``[B, beams]`` m."""
        usable = self._masks[2]
        is_return = (ranges > 0.0) & (ranges <= self._max_range) & usable
        cleaned = torch.where(is_return, ranges, self._max_range)
        return torch.where(_is_too_near(ranges) & usable, self._radius, cleaned)

    def usable(self, ranges: Tensor) -> Tensor:
        """Return :meth:`navrl.deploy.ScanCheck.usable`, ``[B, beams]`` bool."""
        return self._masks[2] & ~self._invalid(ranges)

    def sensed(self, ranges: Tensor, pose: Tensor | None, path: Tensor | None) -> Tensor:
        """Return the state ``[B]`` that follows from scan, pose and path, a number of ``STATES``.

        A pose that is not finite, or whose yaw is not in radians, counts as off the path.

        Args:
            ranges: ``[B, beams]`` m, as measured.
            pose: ``[B, 3]`` float64 (x, y, yaw), m and rad; ``None`` if the policy reads none.
            path: ``[B, P, 2]`` float64 m, in the same frame.
        """
        near = [
            _is_too_near(ranges[:, sector]) & self._masks[2][sector] for sector in self._sectors
        ]
        is_blocked = torch.stack([each.any(-1) for each in near]).any(0)
        state = _number(DriveState.DRIVE, is_blocked)
        state = torch.where(is_blocked, _number(DriveState.BLOCKED, state), state)
        if pose is not None and path is not None:
            state = self._placed(state, pose, path)
        return torch.where(self._is_blind(ranges), _number(DriveState.BLIND, state), state)

    def decided(self, state: Tensor, command: Tensor, *sensors: Tensor) -> tuple[Tensor, Tensor]:
        """Return the state ``[B]`` after the policy's command, and whether to store observations.

        Args:
            state: ``[B]``, of :meth:`sensed`.
            command: ``[B, C]``.
            sensors: Further inputs ``[B, ...]``; one that is not finite makes the command bad.
        """
        values = [command, *(value.flatten(1) for value in sensors)]
        is_finite = torch.stack([value.isfinite().all(-1) for value in values]).all(0)
        is_first = (state == STATES.index(DriveState.BLIND)) | (
            state == STATES.index(DriveState.OFF_PATH)
        )
        bad = _number(DriveState.BAD_COMMAND, state)
        state = torch.where(is_finite | is_first, state, bad)
        stored = torch.stack([state != STATES.index(each) for each in _NOT_STORED]).all(0)
        return state, stored

    def _placed(self, state: Tensor, pose: Tensor, path: Tensor) -> Tensor:
        relative = path - pose[:, None, :2]
        goal_distance = torch.hypot(relative[:, -1, 0], relative[:, -1, 1])
        is_pose = pose.isfinite().all(-1) & (pose[:, 2].abs() <= _MAX_YAW)
        origin = torch.zeros_like(relative[:, 0], dtype=torch.float32)
        distance = project_onto_path(relative.float(), origin).distance
        is_near = is_pose & (distance <= self._limits.max_path_distance)  # False for NaN
        state = torch.where(is_near, state, _number(DriveState.OFF_PATH, state))
        is_at_goal = is_pose & (goal_distance <= self._limits.goal_radius)
        return torch.where(is_at_goal, _number(DriveState.AT_GOAL, state), state)

    def _is_blind(self, ranges: Tensor) -> Tensor:
        required, covered, _ = self._masks
        if not self._sees_ahead:
            return torch.ones_like(ranges[:, 0], dtype=torch.bool)
        share = self._measured(ranges)[:, required.nonzero()[:, 0]].double().mean(-1)
        invalid = self._invalid(ranges) | covered
        wide = [self._has_wide_gap(invalid[:, sector]) for sector in self._sectors]
        return (share < self._limits.min_measured_share) | torch.stack(wide).any(0)

    def _has_wide_gap(self, invalid: Tensor) -> Tensor:
        """Return whether more than the allowed neighbors are invalid, ``[B]``."""
        count = math.floor(self._max_gap_beams) + 1
        if count > invalid.shape[-1]:
            return torch.zeros_like(invalid[:, 0])
        total = torch.nn.functional.pad(invalid.long().cumsum(-1), (1, 0))
        return (total[:, count:] - total[:, :-count] == count).any(-1)

    def _invalid(self, ranges: Tensor) -> Tensor:
        too_large = (ranges > self._limits.sensor_range) & (ranges < _largest(ranges))
        return ranges.isnan() | ((ranges < 0.0) & ~_is_too_near(ranges)) | too_large

    def _measured(self, ranges: Tensor) -> Tensor:
        in_range = (ranges > 0.0) & (ranges < self._max_range - RETURN_MARGIN_M)
        beyond = (ranges > self._max_range) & (ranges < _largest(ranges))
        return in_range | (beyond & (ranges <= self._limits.sensor_range))


def _is_too_near(ranges: Tensor) -> Tensor:
    return ranges == -math.inf


def _largest(ranges: Tensor) -> Tensor:
    """Return the largest finite reading, m; zero if there is none."""
    return torch.where(ranges.isfinite(), ranges, 0.0).amax(-1, keepdim=True).clamp_min(0.0)


def _number(state: DriveState, like: Tensor) -> Tensor:
    return torch.full_like(like, STATES.index(state), dtype=torch.int64)
