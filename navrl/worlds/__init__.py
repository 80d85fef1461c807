"""Scenarios as data, their generators and named suites, without physics."""

# ruff: noqa: E402 - missing packages are reported before a module that needs them is imported

from navrl.extras import require

require("full", "navrl.worlds", "skimage")

from navrl.worlds.batch import ScenarioBatch, pedestrian_boxes
from navrl.worlds.cards import CardSet
from navrl.worlds.corridor import Corridor
from navrl.worlds.distribution import ScenarioDistribution, WeightedWorld
from navrl.worlds.frozen import FrozenEpisodes, FrozenSuiteError, frozen_episodes, frozen_names
from navrl.worlds.intersection import Intersection
from navrl.worlds.layout import Layout, World
from navrl.worlds.office import Office
from navrl.worlds.pool import ScenarioPool
from navrl.worlds.scenario import MAX_PATH_POINTS, MAX_ROUTE_POINTS, Pedestrian, Scenario
from navrl.worlds.suite import Suite

__all__ = [
    "MAX_PATH_POINTS",
    "MAX_ROUTE_POINTS",
    "CardSet",
    "Corridor",
    "FrozenEpisodes",
    "FrozenSuiteError",
    "Intersection",
    "Layout",
    "Office",
    "Pedestrian",
    "Scenario",
    "ScenarioBatch",
    "ScenarioDistribution",
    "ScenarioPool",
    "Suite",
    "WeightedWorld",
    "World",
    "frozen_episodes",
    "frozen_names",
    "pedestrian_boxes",
]
