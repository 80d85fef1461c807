from .bundle import BundleError, PolicyBundle, load_bundle, save_bundle, saved_metrics
from .names import ZOO, zoo_names

__all__ = [
    "ZOO",
    "BundleError",
    "PolicyBundle",
    "load_bundle",
    "save_bundle",
    "saved_metrics",
    "zoo_names",
]
