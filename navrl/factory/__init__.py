"""Composition root: builds all objects from a resolved configuration."""

# ruff: noqa: E402 - missing packages are reported before a module that needs them is imported

from navrl.extras import require

require("full", "navrl.factory", "hydra", "safetensors", "skimage", "tqdm", "yaml")

from navrl.factory.environment import make_env, make_navigation_env, make_pool, set_threads
from navrl.factory.gymnasium import make_gymnasium_env
from navrl.factory.policy import EvaluatedPolicy, bundle_folder, make_evaluated_policy, policy_name
from navrl.factory.training import make_agent, make_trainer, observation_shapes, save_policy

__all__ = [
    "EvaluatedPolicy",
    "bundle_folder",
    "make_agent",
    "make_env",
    "make_evaluated_policy",
    "make_gymnasium_env",
    "make_navigation_env",
    "make_pool",
    "make_trainer",
    "observation_shapes",
    "policy_name",
    "save_policy",
    "set_threads",
]
