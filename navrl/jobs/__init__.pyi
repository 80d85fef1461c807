from .benchmark import run_benchmark
from .evaluation import check_errors, check_evaluation, record, run_evaluation
from .finished import finished_evaluation, unchanged_evaluation
from .latency import measure_latency
from .resuming import record_config, resumed_config
from .run_folder import claim_folder
from .run_lock import locked, new_folder
from .suite_data import missing_data

__all__ = [
    "check_errors",
    "check_evaluation",
    "claim_folder",
    "finished_evaluation",
    "locked",
    "measure_latency",
    "missing_data",
    "new_folder",
    "record",
    "record_config",
    "resumed_config",
    "run_benchmark",
    "run_evaluation",
    "unchanged_evaluation",
]
