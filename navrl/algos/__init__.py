"""Reinforcement learning algorithms based on TorchRL's losses."""

from navrl.algos.ddpg import DDPG, NonFiniteUpdateError
from navrl.algos.exploration import GaussianExploration
from navrl.algos.td3 import TD3

__all__ = ["DDPG", "TD3", "GaussianExploration", "NonFiniteUpdateError"]
