"""The GPU's rows, put together on the CPU; on a GPU, measured."""

import numpy as np
import pytest

from navrl import jobs
from navrl.benchmarks import Budget, gpu_rows, random_transitions
from navrl.config import compose
from navrl.jobs.benchmark import _learner, _maker, _simulator
from navrl.ops import backend

OPTIONS = ["rows=[gpu]", "effort=quick", "effort.gpu_worlds=4", "pool_size=4", "scenario=corridor"]
OPTIONS += ["network=small", "replay.batch_size=8"]
BARS = {"gpu.steps": "≥ 1,000,000", "gpu.update_recorded": "≥ 1,500", "gpu.paper": "≤ 10"}


@pytest.mark.slow
def test_rows_have_their_limits():
    cfg = compose("benchmark", OPTIONS)
    env = _maker(cfg)(4)
    shapes = {"spatial": [180, 2], "temporal": [30, 4], "waypoints_scaled": [5, 2]}
    learner = _learner(cfg, shapes, "float32", "cpu")
    batch = random_transitions(shapes, 8)
    frames = np.array([50_000.0, 90_000.0])
    learners = {"eager": learner, "recorded": learner}
    rows = gpu_rows(_simulator(cfg, 4), env, learners, batch, frames, Budget(0.01, 2))
    assert {row.key: str(row.bar) for row in rows if row.bar} == BARS
    found = {row.key: row for row in rows}
    assert found["gpu.paper"].values == pytest.approx([9.0, 5.0])  # 27 million steps
    assert all(row.median > 0 for row in rows) and env.is_closed


def test_missing_gpu_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr("navrl.jobs.benchmark.missing_for_cuda", lambda: "a device")
    report = jobs.run_benchmark(compose("benchmark", [*OPTIONS, "rows=[icp_tagd,gpu]"]), tmp_path)
    assert report.skipped == ["gpu: needs a device"]
    with pytest.raises(ValueError, match="gpu: needs a device"):
        jobs.run_benchmark(compose("benchmark", OPTIONS), tmp_path)


def test_other_rows_measure_the_cpu(tmp_path, monkeypatch):
    monkeypatch.setattr("navrl.jobs.benchmark.make_device", lambda _: backend.torch.device("cuda"))
    with pytest.raises(ValueError, match=r"device=cuda: rows=\[gpu\] measures a GPU"):
        jobs.run_benchmark(compose("benchmark", [*OPTIONS, "device=cuda"]), tmp_path)


@pytest.mark.gpu
def test_a_gpu_is_measured(tmp_path):
    report = jobs.run_benchmark(compose("benchmark", OPTIONS), tmp_path)
    assert {row.key for row in report.rows} >= BARS.keys()
