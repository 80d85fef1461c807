"""Policies: trained bundles, the zoo of the package, and classical controllers."""

from pathlib import Path

from navrl.policies.bundle import BundleError, PolicyBundle, load_bundle, save_bundle, saved_metrics
from navrl.policies.controller import Controller
from navrl.policies.predicting import PredictingPolicy, StableBaselines3Policy

ZOO = Path(__file__).parent / "zoo"
"""Folder of the bundles of the package, one folder each."""

__all__ = [
    "ZOO",
    "BundleError",
    "Controller",
    "PolicyBundle",
    "PredictingPolicy",
    "StableBaselines3Policy",
    "load_bundle",
    "save_bundle",
    "saved_metrics",
    "zoo_names",
]


def zoo_names() -> list[str]:
    """Return the names of the bundles in the zoo."""
    return sorted(folder.name for folder in ZOO.glob("*") if (folder / "config.yaml").is_file())
