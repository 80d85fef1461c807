"""Learning algorithms on TorchRL's losses."""

from navrl.algos.ddpg import DDPG, NonFiniteUpdateError
from navrl.algos.exploration import GaussianExploration

__all__ = ["DDPG", "GaussianExploration", "NonFiniteUpdateError"]
