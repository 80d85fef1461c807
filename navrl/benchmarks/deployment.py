"""Memory, start-up and latency of driving processes: ONNX file compared with the runner."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import navrl
from navrl.benchmarks import driving_process
from navrl.benchmarks.results import Bar, Row, at_most


def deploy_rows(
    bundle: Path, file: Path, golden: Mapping[str, np.ndarray], repeats: int
) -> list[Row]:
    """Measure new processes that drive, alternately, on one core each.

    Args:
        bundle: Folder of the policy, for :class:`navrl.deploy.PolicyRunner`.
        file: The same policy as an ONNX file.
        golden: Recorded drives, of :func:`navrl.export.golden.record`.
        repeats: Processes of each kind.
    """
    found: dict[str, list[dict]] = {"runner": [], "onnx": []}
    with tempfile.TemporaryDirectory() as folder:
        recorded = Path(folder) / "drive.npz"
        arrays: dict[str, Any] = dict(golden)
        np.savez(recorded, **arrays)
        policies = {"runner": bundle, "onnx": file}
        for _ in range(repeats):
            for kind, policy in policies.items():
                found[kind].append(_drive(kind, policy, recorded))
    memory = {kind: _values(runs, "memory_mb") for kind, runs in found.items()}
    cpu = {kind: _values(runs, "cpu_s") for kind, runs in found.items()}
    times = {kind: _values(runs, "milliseconds") for kind, runs in found.items()}
    median = {kind: np.median(values, axis=1) for kind, values in times.items()}
    p99 = np.percentile(times["onnx"], 99, axis=1)
    memory_ratio, cpu_ratio = memory["runner"] / memory["onnx"], cpu["runner"] / cpu["onnx"]
    return [
        Row("deploy.memory_runner", "process that drives, memory: runner", "MB", memory["runner"]),
        Row("deploy.memory", "… ONNX file", "MB", memory["onnx"]),
        Row("deploy.memory_ratio", "… runner / ONNX file", "x", memory_ratio, Bar(6.0)),
        Row("deploy.cpu_runner", "CPU time to the first command: runner", "s", cpu["runner"]),
        Row("deploy.cpu", "… ONNX file", "s", cpu["onnx"]),
        Row("deploy.cpu_ratio", "… runner / ONNX file", "x", cpu_ratio, Bar(10.0)),
        Row("deploy.median_runner", "scan in, command out: runner", "ms", median["runner"]),
        Row("deploy.median", "… ONNX file", "ms", median["onnx"]),
        Row(
            "deploy.median_ratio",
            "… ONNX file / runner",
            "x",
            median["onnx"] / median["runner"],
            at_most(1.0),
        ),
        Row(
            "deploy.p99_ratio",
            "… ONNX file: 99 % within / median",
            "x",
            p99 / median["onnx"],
            at_most(2.0),
        ),
    ]


def _values(runs: list[dict], name: str) -> np.ndarray:
    return np.array([run[name] for run in runs])


def _drive(kind: str, policy: Path, recorded: Path) -> dict:
    """Return the measurements of a process of :mod:`navrl.benchmarks.driving_process`."""
    package = str(Path(navrl.__file__).parents[1])
    path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, driving_process.__file__, kind, str(policy), str(recorded)],
        env={**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1])
