"""Deployment of trained policies on a robot, without a simulator."""

from navrl.deploy.runner import PolicyRunner
from navrl.deploy.safety import DriveState, SafetyLimits, ScanCheck

__all__ = ["DriveState", "PolicyRunner", "SafetyLimits", "ScanCheck"]
