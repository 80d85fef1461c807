"""The command as a user runs it, small and quick. Speeds are shown, never asserted."""

import contextlib
import io
import json
import math
import shlex
from importlib.util import find_spec

import pages
import pytest
import torch

from navrl import jobs
from navrl.algos.precision import choose_precision
from navrl.config import compose
from navrl.jobs.benchmark import MEASURED
from navrl.jobs.row_names import ROWS
from navrl.viz import plot_benchmark

COMMAND = [
    *("navrl-benchmark", "effort=quick", "effort.repeats=1", "num_worlds=8"),
    *("effort.step_worlds=8", "effort.memory_worlds=8"),
    *("pool_size=4", "scenario=corridor", "network=small", "replay.batch_size=8"),
    "hydra.run.dir=run",
]
WITHOUT_OTHERS = {
    *("scan.one_core", "scan.beams", "scan.bullet", "scan.ratio"),
    *("step.one_core", "step.bullet", "step.ratio", "icp_tagd.paper", "icp_tagd.robust"),
    *("memory.worlds", "growth.worlds", "growth.beams", "growth.boxes", "growth.pedestrians"),
    *(
        "update.flops",
        "update.done",
        "update.float32.updates",
        "update.float32.ceiling",
        "update.float32.share",
    ),
    *("update.bfloat16.updates", "update.bfloat16.ceiling", "update.bfloat16.share"),
    *("training.frames", "training.updates", "training.environment", "training.update"),
    *("training.act", "training.replay_write", "training.replay_sample"),
    "latency.median",
    "latency.p99",
    *("startup.torch", "startup.help", "startup.override", "startup.suites", "startup.ratio"),
}


@pytest.fixture(scope="module")
def run(once):
    folder = once("benchmark", measured)
    return folder / "run", (folder / "printed").read_text()


def measured(folder):
    """Run the command in a folder; write there what it prints."""
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()) as printed:
        assert pages.exit_status(shlex.join(COMMAND)) == 0
    (folder / "printed").write_text(printed.getvalue())


@pytest.mark.slow
def test_the_json_has_all_rows_with_proper_numbers(run):
    report = json.loads((run[0] / "benchmark.json").read_text())
    rows = {row["key"]: row for row in report["rows"]}
    assert rows.keys() >= WITHOUT_OTHERS
    for key, row in rows.items():
        numbers = [row["median"], *row["quartiles"], *row["values"]]
        assert all(math.isfinite(value) for value in numbers), key
        assert key.startswith("growth.") or all(value > 0 for value in numbers), key
        assert row["quartiles"][0] <= row["median"] <= row["quartiles"][1]
    assert report["machine"].keys() >= {"processor", "cores", "load", "torch", "numba"}
    shares = [row["median"] for key, row in rows.items() if key.startswith("training.")][2:]
    assert sum(shares) == pytest.approx(100, abs=5)


@pytest.mark.slow
def test_table_contains_every_limit(run):
    report = json.loads((run[0] / "benchmark.json").read_text())
    bars = {row["key"]: row["bar"] for row in report["rows"] if row["bar"]}
    wanted = {
        "scan.one_core": (30_000, True),
        "step.one_core": (15_000, True),
        "step.ratio": (40, True),
        "icp_tagd.paper": (30, False),
        "memory.worlds": (1000, False),
        "growth.beams": (1, False),
        "growth.boxes": (1, False),
        f"update.{choose_precision(torch.device('cpu'))}.share": (50, True),
        "training.environment": (10, False),
        "latency.p99": (3, False),
        "startup.ratio": (0.5, False),
    }
    for key, (limit, least) in wanted.items():
        assert bars[key] == {"limit": limit, "least": least}, key


@pytest.mark.slow
def test_one_table_is_printed_with_every_row(run):
    report = json.loads((run[0] / "benchmark.json").read_text())
    table = [line for line in run[1].splitlines() if line.startswith("| ")]
    assert len(table) == len(report["rows"]) + 2
    assert report["machine"]["processor"] in run[1]


@pytest.mark.slow
def test_missing_peers_are_named(run):
    report = json.loads((run[0] / "benchmark.json").read_text())
    keys, skipped = {row["key"] for row in report["rows"]}, " ".join(report["skipped"])
    for name, module in (("navground", "navground"), ("ir_sim", "irsim")):
        is_there = find_spec(module) is not None
        assert (f"peers.{name}_ratio" in keys) == is_there
        assert (f"{name}: not installed" in skipped) != is_there


@pytest.mark.slow
def test_picture_is_written(run):
    assert (run[0] / "benchmark.png").read_bytes().startswith(b"\x89PNG")
    text = (run[0] / "benchmark.svg").read_text()
    for words in ("bars reached", "growth with boxes", "a training's time"):
        assert words in text


@pytest.mark.parametrize(
    "rows", [["warp_drive"], [], ["latency", "latency"]], ids=["unknown", "none", "twice"]
)
def test_unknown_row_error_lists_known_rows(rows, tmp_path):
    cfg = compose("benchmark", [f"rows=[{','.join(rows)}]"])
    with pytest.raises(ValueError, match="latency") as error:
        jobs.run_benchmark(cfg, tmp_path)
    assert all(name in str(error.value) for name in ROWS)


def test_each_row_name_is_measured():
    assert tuple(MEASURED) == ROWS


def test_a_picture_needs_a_report(tmp_path):
    (tmp_path / "benchmark.json").write_text("{}")
    with pytest.raises(ValueError, match="must be a benchmark report"):
        plot_benchmark(tmp_path / "benchmark.json", tmp_path / "picture")
