"""Process that drives a policy along recorded scans; run as a script by its path.

Arguments: ``onnx`` or ``runner``, the policy's file or folder, and a ``.npz`` of golden drives. It
prints the CPU time to the first command, the largest memory and the latencies as JSON.
"""

import importlib.util
import json
import resource
import sys
import time
from pathlib import Path
from typing import Protocol

import numpy as np

_LOADER = Path(__file__).parents[1] / "export" / "onnx_policy.py"


class Policy(Protocol):
    """The part of a runner that is measured."""

    def reset(self) -> None:
        """Begin another drive."""
        ...

    def act(self, ranges: np.ndarray, pose: np.ndarray, path: np.ndarray) -> np.ndarray:
        """Return the command."""
        ...


def _policy(kind: str, policy: str) -> Policy:
    """Return the policy; that of an ONNX file without importing any other part of navrl."""
    if kind == "runner":
        import torch

        from navrl.deploy import PolicyRunner

        torch.set_num_threads(1)
        return PolicyRunner.from_bundle(policy)
    spec = importlib.util.spec_from_file_location("onnx_policy", _LOADER)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.OnnxPolicy(policy)


def _peak_mb() -> float:
    """Return the largest memory of this process since it began, MB."""
    status = Path("/proc/self/status")
    if status.is_file():
        (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) * 1024 / 1e6
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def main() -> None:
    """Drive and print the measurements."""
    kind, folder, file = sys.argv[1:]
    with np.load(file) as arrays:
        golden = dict(arrays)
    policy, cpu_s, milliseconds = _policy(kind, folder), 0.0, []
    for step, drive in enumerate(golden["drive"]):
        if step and drive != golden["drive"][step - 1]:
            policy.reset()
        ranges = golden["ranges_mm"][step].astype(np.float32) / np.float32(1000.0)
        start = time.perf_counter()
        policy.act(ranges, golden["pose"][step], golden["path"][drive])
        milliseconds.append(1e3 * (time.perf_counter() - start))
        cpu_s = cpu_s or time.process_time()
    print(json.dumps({"cpu_s": cpu_s, "memory_mb": _peak_mb(), "milliseconds": milliseconds[1:]}))


if __name__ == "__main__":
    main()
