"""CUDA kernels do what the CPU's do: simulated and compiled anywhere, run on a GPU."""

import importlib.util
import os
import pickle
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from cuda_cases import CASES, assert_same

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def run(script, file, **environment):
    """Run a script beside this file in a process of its own; return what it printed."""
    paths = (ROOT, HERE, HERE.parent / "sim")
    environment["PYTHONPATH"] = os.pathsep.join(map(str, paths))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", HERE / script, file],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def simulated(once):
    """What the simulator made of all cases, and the file that holds it."""
    file = once("cuda", simulate) / "simulated.pickle"
    return file, pickle.loads(file.read_bytes())


def simulate(folder):
    file = folder / "simulated.pickle"
    run("cuda_simulation.py", file, NUMBA_ENABLE_CUDASIM="1", NUMBA_DISABLE_JIT="1")


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_simulated_cuda_kernels_equal_the_cpu(simulated, name):
    results = simulated[1]["results"][name]
    results = {key: torch.from_numpy(value) for key, value in results.items()}
    assert_same(name, results, CASES[name]("cpu"))


@pytest.mark.slow
def test_all_kernels_are_simulated_and_compile(simulated):
    if importlib.util.find_spec("numba_cuda") is None:
        pytest.skip("needs the extra cuda")
    file, found = simulated
    lines = run("cuda_compilation.py", file).splitlines()
    assert {line.split()[0] for line in lines} == set(found["signatures"])
    assert len(lines) == sum(map(len, found["signatures"].values()))


@pytest.mark.gpu
@pytest.mark.parametrize("name", CASES)
def test_gpu_results_equal_the_cpu(name):
    assert_same(name, CASES[name]("cuda"), CASES[name]("cpu"))
