"""Reinforcement learning algorithms based on TorchRL's losses."""

from navrl.algos.action_smoothness import ActionSmoothness
from navrl.algos.ddpg import DDPG
from navrl.algos.exploration import CorrelatedExploration, GaussianExploration, SquashedExploration
from navrl.algos.ppo import PPO
from navrl.algos.precision import Precision
from navrl.algos.protocols import Algorithm, Exploration, NonFiniteUpdateError
from navrl.algos.sac import SAC
from navrl.algos.td3 import TD3

__all__ = [
    "DDPG",
    "PPO",
    "SAC",
    "TD3",
    "ActionSmoothness",
    "Algorithm",
    "CorrelatedExploration",
    "Exploration",
    "GaussianExploration",
    "NonFiniteUpdateError",
    "Precision",
    "SquashedExploration",
]
