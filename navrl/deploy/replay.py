"""Replay of a log through the control loop: what a policy would have commanded."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDictBase

from navrl import keys
from navrl.checks import check_positive
from navrl.deploy.bags.messages import (
    Logged,
    LoggedCommand,
    LoggedOdometry,
    LoggedPath,
    LoggedPose,
    LoggedScan,
)
from navrl.deploy.bags.sources import LogSource
from navrl.deploy.control_status import ControlStatus
from navrl.deploy.controller import Controller
from navrl.deploy.motion_buffer import relative_pose
from navrl.deploy.recorded_paths import PathPlan
from navrl.deploy.safety import DriveState
from navrl.transforms.requested import is_shielded, requested_action

Clock = Literal["received", "stamp"]
_STORED = (DriveState.DRIVE, DriveState.AT_GOAL, DriveState.BLOCKED)  # decisions with a new scan
_CHANGED = 1e-4  # m/s or rad/s by which a shield must change a command to count


@dataclass(frozen=True, eq=False)
class ReplayedTick:
    """State of a replay after a tick.

    Args:
        time_s: Time since the first scan, s.
        status: Status of the controller.
        observation: Keys of the decision ``[1, ...]``; None if this tick repeated the last command.
        requested: (v, w) of the policy before its shield at this decision, m/s and rad/s; None as
            ``observation``.
        is_shielded: Whether the shield replaced the command of this decision.
        recorded: (v, w) that the robot was commanded in the log; None if unknown.
        measured: (v, w) of the log's odometry; None if unknown.
        icp_error: Difference between the alignment and the log's poses since the last decision, m
            and rad; None without an alignment.
        moved: Distance and turn between the two decisions by the poses, m and rad, likewise.
    """

    time_s: float
    status: ControlStatus
    observation: TensorDictBase | None = None
    requested: tuple[float, float] | None = None
    is_shielded: bool = False
    recorded: tuple[float, float] | None = None
    measured: tuple[float, float] | None = None
    icp_error: tuple[float, float] | None = None
    moved: tuple[float, float] | None = None


class Replay:
    """Replay of a log through a controller.

    The robot drives as recorded: each decision is what the policy would do there, and its commands
    do not change what follows.

    Args:
        control: Controller with the scanner of the log.
        source: Inputs of the log.
        plan: Paths that the controller is given.
        tick_s: Time between two ticks, s.
        start_s: Time after the first scan at which the replay starts, s.
        duration_s: Time after which it ends, s; None for the whole log.
        clock: ``received`` for the times at which messages were recorded, as on the robot;
            ``stamp`` for those of their headers, if the log was recorded with another clock.

    Attributes:
        rejected: Number of inputs that the controller refused, by reason.

    Raises:
        ValueError: If a value is out of range.
    """

    def __init__(
        self,
        control: Controller,
        source: LogSource,
        plan: PathPlan,
        tick_s: float = 0.05,
        start_s: float = 0.0,
        duration_s: float | None = None,
        clock: Clock = "received",
    ) -> None:
        """Check and store the arguments."""
        check_positive(tick_s=tick_s)
        if not 0.0 <= start_s < math.inf:
            raise ValueError(f"start_s={start_s}: must be finite and >= 0")
        if duration_s is not None:
            check_positive(duration_s=duration_s)
        if clock not in ("received", "stamp"):
            raise ValueError(f"clock={clock}: must be received or stamp")
        self.control, self.source, self.plan, self.tick_s = control, source, plan, tick_s
        self.start_s, self.end_s = start_s, math.inf if duration_s is None else start_s + duration_s
        self.clock: Clock = clock
        self.rejected: Counter[str] = Counter()
        self._recorded: tuple[float, float] | None = None
        self._measured: tuple[float, float] | None = None
        self._last_pose: np.ndarray | None = None
        self._counts = (0, 0)

    def ticks(self) -> Iterator[ReplayedTick]:
        """Yield the state after each tick.

        Raises:
            ValueError: If the log ends before the start.
        """
        first, count, now = None, 0, -math.inf
        for now, message in self._timed(self.source.messages()):
            if first is None:
                if not isinstance(message, LoggedScan):
                    self._give(message)
                    continue
                first = now + self.start_s
            while first + count * self.tick_s < now:
                if count * self.tick_s > self.end_s - self.start_s:
                    return
                yield self._tick(first, count)
                count += 1
            self._give(message)
        if first is not None and first > now:
            length = now - first + self.start_s
            raise ValueError(
                f"start_s={self.start_s:g}: must be below {length:.1f} s, the length of the log "
                "after its first scan"
            )
        if first is not None:
            yield self._tick(first, count)

    def _timed(self, messages: Iterator[Logged]) -> Iterator[tuple[float, Logged]]:
        """Yield messages with their time on the chosen clock, which never goes back."""
        now = -math.inf
        for message in messages:
            time = message.received
            if self.clock == "stamp":
                time = now if isinstance(message, LoggedCommand) else message.stamp
            now = max(now, time)
            yield now, message

    def _give(self, message: Logged) -> None:
        control = self.control
        if isinstance(message, LoggedCommand):
            self._recorded = message.command
            return
        try:
            if isinstance(message, LoggedScan):
                angles = (message.angle_min, message.angle_increment)
                limits = (message.range_min, message.range_max, message.duration_s)
                control.on_scan(message.stamp, message.ranges, *angles, *limits)
            elif isinstance(message, LoggedOdometry):
                self._measured = message.velocity
                control.on_odometry(message.stamp, message.pose, message.velocity)
            elif isinstance(message, LoggedPose):
                control.on_pose(message.stamp, message.pose)
            elif isinstance(message, LoggedPath) and self.plan.reads_topic:
                control.on_path(message.points if len(message.points) else None)
        except ValueError as error:
            reason = re.sub(r"^stamp=[^:]*: (.*), which.*", r"stamp: \1", str(error))  # one for all
            self.rejected[reason] += 1

    def _tick(self, first: float, count: int) -> ReplayedTick:
        now = first + count * self.tick_s
        before = self.control.status
        path = self.plan.path_at(now, None if before is None else before.pose)
        if path is not None:
            self.control.on_path(path)
        self.control.tick(now)
        status = self.control.status
        assert status is not None  # after a tick
        decision = self._decision(status)
        return ReplayedTick(
            self.start_s + count * self.tick_s,
            status,
            recorded=self._recorded,
            measured=self._measured,
            **decision,
        )

    def _decision(self, status: ControlStatus) -> dict[str, Any]:
        """Return the arguments of :class:`ReplayedTick` that belong to a decision of this tick."""
        counts, self._counts = self._counts, (status.num_steps, status.num_resets)
        observation = self.control.runner.observation
        is_stored = self.control.runner.state in _STORED
        if status.num_steps == counts[0] or observation is None or not is_stored:
            return {}
        pose = np.array(observation.get(keys.POSE))[0]
        before, self._last_pose = self._last_pose, pose.copy()
        found: dict[str, Any] = {"observation": observation, **self._request(observation, status)}
        if before is None or status.num_resets > counts[1] or status.icp_transform is None:
            return found
        moved = relative_pose(pose, before)
        offset = status.icp_transform - moved
        turned = math.remainder(float(offset[2]), math.tau)
        found["icp_error"] = (float(np.hypot(*offset[:2])), abs(turned))
        found["moved"] = (float(np.hypot(*moved[:2])), abs(float(moved[2])))
        return found

    @torch.no_grad()
    def _request(self, observation: TensorDictBase, status: ControlStatus) -> dict[str, Any]:
        """Return the policy's command before the shield, and whether the shield replaced it."""
        transform = self.control.runner.transform
        asked = requested_action(transform, observation.copy())[0]
        requested = (float(asked[0]), float(asked[1]))
        if not is_shielded(transform):
            return {"requested": requested}
        given = transform.inv(observation.copy())[keys.ACTION][0]
        changed = bool((given - asked).abs().max() > _CHANGED)
        return {"requested": requested, "is_shielded": changed and status.state is DriveState.DRIVE}
