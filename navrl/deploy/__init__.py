"""Trained policies outside of a simulator: on a robot, in a node, behind another planner."""

from navrl.deploy.runner import PolicyRunner
from navrl.deploy.safety import DriveState, SafetyLimits, ScanCheck

__all__ = ["DriveState", "PolicyRunner", "SafetyLimits", "ScanCheck"]
