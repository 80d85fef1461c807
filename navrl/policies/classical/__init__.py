"""Classical controllers; like trained actors, they write normalized actions."""

from navrl.policies.classical.dynamic_window import DynamicWindow
from navrl.policies.classical.fixed import StandStill, UniformRandom
from navrl.policies.classical.oracle import Oracle, SearchEffort
from navrl.policies.classical.orca import Orca
from navrl.policies.classical.pure_pursuit import PurePursuit
from navrl.policies.classical.stop_and_go import StopAndGo
from navrl.policies.classical.waypoint_subgoal import WaypointSubgoal

__all__ = [
    "DynamicWindow",
    "Oracle",
    "Orca",
    "PurePursuit",
    "SearchEffort",
    "StandStill",
    "StopAndGo",
    "UniformRandom",
    "WaypointSubgoal",
]
