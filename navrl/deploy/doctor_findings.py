"""Findings of a log and the facts that they follow from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from navrl.deploy.bags.sources import LogSource
from navrl.deploy.control_limits import ControlLimits
from navrl.deploy.doctor import LogMeasures
from navrl.ops.scanner import Scanner
from navrl.sim import Lidar, RobotModel


class Level(IntEnum):
    """Severity of a finding."""

    OK = 0
    WARNING = 1
    FAILURE = 2


VERDICTS = {Level.OK: "ok", Level.WARNING: "warnings", Level.FAILURE: "will not work"}
"""Verdict by the most severe finding."""


@dataclass(frozen=True)
class Finding:
    """Finding about a log.

    Args:
        level: Severity.
        subject: What it is about, e.g. ``scan rate``.
        text: What was found.
        action: What to do about it; empty if nothing.
    """

    level: Level
    subject: str
    text: str
    action: str = ""


@dataclass(frozen=True)
class Checked:
    """Facts that the checks compare.

    Args:
        measures: Measurements of the log.
        source: The log.
        scanner: Its lidar with the mount.
        mount_source: Source of the mount, in words.
        lidar: Lidar of the policy.
        robot: Robot of the policy.
        limits: Timeouts of the control loop.
        time_step_s: Time step of the policy, s.
        network_range: Distance to which the network reads, m; None for the range of its lidar. An
            alignment may use more.
    """

    measures: LogMeasures
    source: LogSource
    scanner: Scanner
    mount_source: str
    lidar: Lidar
    robot: RobotModel
    limits: ControlLimits
    time_step_s: float
    network_range: float | None = None


def verdict(findings: list[Finding]) -> Level:
    """Return the level of the most severe finding."""
    return max((finding.level for finding in findings), default=Level.OK)
