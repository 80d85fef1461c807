from .batch import ScenarioBatch
from .cards import CardSet
from .corridor import Corridor
from .distribution import ScenarioDistribution, WeightedWorld
from .frozen import FrozenEpisodes, FrozenSuiteError, frozen_episodes, frozen_names
from .intersection import Intersection
from .layout import Layout, World
from .office import Office
from .pool import ScenarioPool
from .scenario import MAX_PATH_POINTS, MAX_ROUTE_POINTS, Pedestrian, Scenario
from .suite import Suite
from .walking import pedestrian_boxes, pedestrian_states, track_gaits

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
    "pedestrian_states",
    "track_gaits",
]
