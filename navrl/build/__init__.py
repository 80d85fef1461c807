"""Composition root: from a resolved config to running objects. Nothing below knows a config."""

# ruff: noqa: E402 - missing packages are reported before a module that needs them is imported

from navrl.extras import require

require("full", "navrl.build", "hydra", "safetensors", "skimage", "tqdm", "yaml")

from navrl.build.benchmark import run_benchmark
from navrl.build.environment import (
    make_env,
    make_navigation_env,
    make_pool,
    set_threads,
)
from navrl.build.evaluation import (
    Contender,
    bundle_folder,
    check_evaluation,
    make_contender,
    record,
    run_evaluation,
)
from navrl.build.finished import finished_evaluation, unchanged_evaluation
from navrl.build.gymnasium import make_gymnasium_env
from navrl.build.latency import measure_latency
from navrl.build.resuming import record_config, resumed_config
from navrl.build.run_folder import claim_folder
from navrl.build.run_lock import locked, new_folder
from navrl.build.training import make_agent, make_trainer, observation_shapes, save_policy

__all__ = [
    "Contender",
    "bundle_folder",
    "check_evaluation",
    "claim_folder",
    "finished_evaluation",
    "locked",
    "make_agent",
    "make_contender",
    "make_env",
    "make_gymnasium_env",
    "make_navigation_env",
    "make_pool",
    "make_trainer",
    "measure_latency",
    "new_folder",
    "observation_shapes",
    "record",
    "record_config",
    "resumed_config",
    "run_benchmark",
    "run_evaluation",
    "save_policy",
    "set_threads",
    "unchanged_evaluation",
]
