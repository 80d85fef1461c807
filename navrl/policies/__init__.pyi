from .bundle import BundleError, PolicyBundle, load_actor, load_bundle, save_bundle, saved_metrics
from .controller import Controller
from .names import ZOO, zoo_names
from .predicting import PredictingPolicy, StableBaselines3Policy

__all__ = [
    "ZOO",
    "BundleError",
    "Controller",
    "PolicyBundle",
    "PredictingPolicy",
    "StableBaselines3Policy",
    "load_actor",
    "load_bundle",
    "save_bundle",
    "saved_metrics",
    "zoo_names",
]
