"""Controllers that learn nothing; they write normalised actions as trained actors do."""

from navrl.policies.classical.fixed import StandStill, UniformRandom
from navrl.policies.classical.oracle import Oracle, SearchEffort
from navrl.policies.classical.pure_pursuit import PurePursuit

__all__ = ["Oracle", "PurePursuit", "SearchEffort", "StandStill", "UniformRandom"]
