"""Jobs of the commands: from a configuration to files in a run folder."""

# ruff: noqa: E402 - missing packages are reported before a module that needs them is imported

from navrl.extras import require

require("full", "navrl.jobs", "hydra", "safetensors", "skimage", "tqdm", "yaml")

from navrl.jobs.benchmark import run_benchmark
from navrl.jobs.evaluation import check_evaluation, record, run_evaluation
from navrl.jobs.finished import finished_evaluation, unchanged_evaluation
from navrl.jobs.latency import measure_latency
from navrl.jobs.resuming import record_config, resumed_config
from navrl.jobs.run_folder import claim_folder
from navrl.jobs.run_lock import locked, new_folder

__all__ = [
    "check_evaluation",
    "claim_folder",
    "finished_evaluation",
    "locked",
    "measure_latency",
    "new_folder",
    "record",
    "record_config",
    "resumed_config",
    "run_benchmark",
    "run_evaluation",
    "unchanged_evaluation",
]
