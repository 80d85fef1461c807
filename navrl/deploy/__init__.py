"""Deployment of trained policies on a robot, without a simulator."""

from navrl.deploy.control_limits import ControlLimits
from navrl.deploy.control_status import Command, ControlStatus
from navrl.deploy.controller import Controller
from navrl.deploy.map_planner import MapPlanner
from navrl.deploy.runner import PolicyRunner
from navrl.deploy.safety import DriveState, SafetyLimits, ScanCheck
from navrl.deploy.scan_adapter import AdaptedScan, adapt_scan, load_scanner
from navrl.ops.scanner import BeamState, Scanner

__all__ = [
    "AdaptedScan",
    "BeamState",
    "Command",
    "ControlLimits",
    "ControlStatus",
    "Controller",
    "DriveState",
    "MapPlanner",
    "PolicyRunner",
    "SafetyLimits",
    "ScanCheck",
    "Scanner",
    "adapt_scan",
    "load_scanner",
]
