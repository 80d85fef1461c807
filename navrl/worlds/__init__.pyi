from .batch import ScenarioBatch
from .cards import CardSet
from .clearance_map import ClearanceMap
from .corridor import Corridor
from .distribution import ScenarioDistribution, WeightedWorld
from .frozen import FrozenEpisodes, FrozenSuiteError, frozen_episodes, frozen_names
from .intersection import Intersection
from .layout import Layout, World
from .office import Office
from .places.barn import load_barn
from .places.distribution import PlaceDistribution
from .places.episodes import PlaceEpisodes
from .places.folder import folder_hash, load_places
from .places.igibson import load_igibson
from .places.map_file import load_map, load_occupancy_map
from .places.occupancy_map import OccupancyMap
from .places.place import FreeRegion, Place
from .places.scene import load_scene
from .places.tracks import load_tracks
from .pool import ScenarioPool
from .rooms.distribution import (
    GeneratedPlaces,
    MixedDistribution,
    PlaceGenerator,
    WeightedDistribution,
)
from .rooms.flat import Flat
from .rooms.hall import Hall
from .scenario import MAX_PATH_POINTS, MAX_ROUTE_POINTS, Pedestrian, Scenario
from .suite import Suite
from .walking import pedestrian_boxes, pedestrian_states, track_gaits

__all__ = [
    "MAX_PATH_POINTS",
    "MAX_ROUTE_POINTS",
    "CardSet",
    "ClearanceMap",
    "Corridor",
    "Flat",
    "FreeRegion",
    "FrozenEpisodes",
    "FrozenSuiteError",
    "GeneratedPlaces",
    "Hall",
    "Intersection",
    "Layout",
    "MixedDistribution",
    "OccupancyMap",
    "Office",
    "Pedestrian",
    "Place",
    "PlaceDistribution",
    "PlaceEpisodes",
    "PlaceGenerator",
    "Scenario",
    "ScenarioBatch",
    "ScenarioDistribution",
    "ScenarioPool",
    "Suite",
    "WeightedDistribution",
    "WeightedWorld",
    "World",
    "folder_hash",
    "frozen_episodes",
    "frozen_names",
    "load_barn",
    "load_igibson",
    "load_map",
    "load_occupancy_map",
    "load_places",
    "load_scene",
    "load_tracks",
    "pedestrian_boxes",
    "pedestrian_states",
    "track_gaits",
]
