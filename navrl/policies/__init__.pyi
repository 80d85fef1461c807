from .bundle import BundleError, PolicyBundle, load_actor, load_bundle, save_bundle, saved_metrics
from .callables import load_policy
from .controller import Controller
from .names import ZOO, zoo_names
from .onnx_policy import OnnxPolicy
from .predicting import PredictingPolicy, StableBaselines3Policy
from .remote import RemotePolicy, RemotePolicyError

__all__ = [
    "ZOO",
    "BundleError",
    "Controller",
    "OnnxPolicy",
    "PolicyBundle",
    "PredictingPolicy",
    "RemotePolicy",
    "RemotePolicyError",
    "StableBaselines3Policy",
    "load_actor",
    "load_bundle",
    "load_policy",
    "save_bundle",
    "saved_metrics",
    "zoo_names",
]
