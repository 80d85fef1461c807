"""Worlds as data: scenarios, their generators and named sets of them. No physics."""

from navrl.worlds.batch import KINDS, ScenarioBatch, pedestrian_boxes
from navrl.worlds.cards import CARDS, SocialCards
from navrl.worlds.corridor import Corridor
from navrl.worlds.distribution import ScenarioDistribution, WeightedWorld
from navrl.worlds.frozen import FrozenSuite, SuiteMismatchError, check_frozen
from navrl.worlds.intersection import Intersection
from navrl.worlds.layout import Layout, World
from navrl.worlds.office import Office
from navrl.worlds.pool import ScenarioPool
from navrl.worlds.scenario import MAX_PATH_POINTS, MAX_ROUTE_POINTS, Pedestrian, Scenario
from navrl.worlds.suite import Suite

__all__ = [
    "CARDS",
    "KINDS",
    "MAX_PATH_POINTS",
    "MAX_ROUTE_POINTS",
    "Corridor",
    "FrozenSuite",
    "Intersection",
    "Layout",
    "Office",
    "Pedestrian",
    "Scenario",
    "ScenarioBatch",
    "ScenarioDistribution",
    "ScenarioPool",
    "SocialCards",
    "Suite",
    "SuiteMismatchError",
    "WeightedWorld",
    "World",
    "check_frozen",
    "pedestrian_boxes",
]
