"""Navigation environment with rewards and outcomes."""

from navrl.envs.navigation import NavigationEnv
from navrl.envs.outcome import Outcome
from navrl.envs.rewards import (
    Collision,
    Goal,
    Guidance,
    Progress,
    Proximity,
    Smoothness,
    Transition,
)
from navrl.envs.transformed import TransformedNavigationEnv

__all__ = [
    "Collision",
    "Goal",
    "Guidance",
    "NavigationEnv",
    "Outcome",
    "Progress",
    "Proximity",
    "Smoothness",
    "TransformedNavigationEnv",
    "Transition",
]
