"""Controllers that learn nothing; they write normalised actions as trained actors do."""

from navrl.policies.classical.fixed import StandStill, UniformRandom
from navrl.policies.classical.pure_pursuit import PurePursuit
from navrl.policies.classical.waypoint_subgoal import WaypointSubgoal

__all__ = ["PurePursuit", "StandStill", "UniformRandom", "WaypointSubgoal"]
