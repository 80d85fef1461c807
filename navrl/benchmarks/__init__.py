"""Measurements of ``navrl-benchmark``: speed and memory, with limits."""

from navrl.benchmarks.collecting import frame_rates, worker_rows
from navrl.benchmarks.deployment import deploy_rows
from navrl.benchmarks.gpu import gpu_rows
from navrl.benchmarks.growth import fit_exponents
from navrl.benchmarks.latency import latency_rows, record_drive
from navrl.benchmarks.learner import count_flops, random_transitions, update_rows
from navrl.benchmarks.machine import describe_machine
from navrl.benchmarks.measurement import Budget, Task, alternate
from navrl.benchmarks.memory import memory_row
from navrl.benchmarks.peers import peer_rows
from navrl.benchmarks.perception import compile_rows, perception_rows
from navrl.benchmarks.results import Bar, Report, Row, Series
from navrl.benchmarks.scanning import growth_series, scan_rows
from navrl.benchmarks.startup import startup_rows
from navrl.benchmarks.stepping import RandomDrive, step_rows, threads_series, worlds_series
from navrl.benchmarks.training import training_rows

__all__ = [
    "Bar",
    "Budget",
    "RandomDrive",
    "Report",
    "Row",
    "Series",
    "Task",
    "alternate",
    "compile_rows",
    "count_flops",
    "deploy_rows",
    "describe_machine",
    "fit_exponents",
    "frame_rates",
    "gpu_rows",
    "growth_series",
    "latency_rows",
    "memory_row",
    "peer_rows",
    "perception_rows",
    "random_transitions",
    "record_drive",
    "scan_rows",
    "startup_rows",
    "step_rows",
    "threads_series",
    "training_rows",
    "update_rows",
    "worker_rows",
    "worlds_series",
]
