"""``navrl-train -m sweep=NAME``: readable folders, one table, and every job goes on by itself."""

import json
import os
import shutil
import subprocess
import sys

import pages
import pytest
from nightly import mostly
from omegaconf import OmegaConf

from navrl.config import CONF_DIR, compose

SWEEPS = sorted(
    path.stem
    for path in (CONF_DIR / "sweep").glob("*.yaml")
    if "experiment" in OmegaConf.load(path).hydra.sweeper.params  # the others are evaluated
)
TINY = [
    *("num_worlds=2", "num_threads=1", "pool_size=2", "scenario=corridor", "network=small"),
    *("replay.batch_size=4", "replay.capacity=100", "validation.num_episodes=2"),
    *("environment.time_limit_steps=4", "schedule.total_frames=16", "schedule.learning_starts=4"),
    *("schedule.frames_per_update=4", "suite=smoke", "progress_bar=false"),
    "simulator@final_simulator=batched",
]


def train(folder, *words):
    return subprocess.run(
        [sys.executable, "-m", "navrl.cli.train", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
    )


@pytest.mark.parametrize("name", mostly(["ablation", "baselines", "seeds"], ["ablation"]))
def test_sweeps_name_experiments_that_exist(name):
    node = OmegaConf.load(CONF_DIR / "sweep" / f"{name}.yaml").hydra
    for experiment in node.sweeper.params.experiment.split(","):
        cfg = compose("train", [f"sweep={name}", f"experiment={experiment}"])
        assert cfg.simulator["_target_"].endswith("BatchedSimulator")
        assert cfg.final_simulator["_target_"].endswith("BulletSimulator")
    assert node.sweep.dir == f"outputs/train/{name}"


def test_final_score_defaults_to_the_training_simulator():
    cfg = compose("train", ["simulator=bullet"])
    assert cfg.final_simulator["_target_"].endswith("BulletSimulator")


def test_unknown_sweep_error_lists_known_sweeps(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert pages.exit_status("navrl-train -m sweep=everything") == 2
    (line,) = [x for x in capfd.readouterr().err.splitlines() if x.startswith("navrl: ")]
    assert "sweep/everything" in line and all(name in line for name in SWEEPS)


@pytest.mark.slow
def test_repeated_sweep_trains_only_missing_jobs(tmp_path):
    words = ["-m", "sweep=seeds", "seed=0,1", *TINY]
    first = train(tmp_path, *words)
    assert first.returncode == 0, first.stderr[-3000:]
    sweep = tmp_path / "outputs" / "train" / "seeds"
    jobs = [sweep / "paper_seed_0", sweep / "paper_seed_1"]
    assert [job.is_dir() for job in jobs] == [True, True]
    (table,) = json.loads((sweep / "comparison.json").read_text())
    assert [row["policy"] for row in table["rows"]] == ["paper_seed_0", "paper_seed_1"]

    # As a kill would leave it: job 1 was trained but not yet judged.
    (jobs[1] / "evaluation" / "summary.json").unlink()
    weights = [job / "policy" / "weights.safetensors" for job in jobs]
    before = [file.stat().st_mtime_ns for file in weights]
    again = train(tmp_path, *words)
    assert again.returncode == 0, again.stderr[-3000:]
    assert again.stdout.count("finished before") == 1
    assert (jobs[1] / "evaluation" / "summary.json").is_file()
    assert [file.stat().st_mtime_ns for file in weights] == before  # resumed, not begun again

    # Other weights in the folder of a finished job are evaluated, and nothing is trained.
    shutil.copy(weights[1], weights[0])
    os.utime(weights[0], (0, 0))
    summaries = [job / "evaluation" / "summary.json" for job in jobs]
    hashes = [json.loads(file.read_text())["policy_hash"] for file in summaries]
    log = (jobs[0] / "metrics.csv").read_bytes()
    last = train(tmp_path, *words)
    assert last.returncode == 0, last.stderr[-3000:]
    assert last.stdout.count("played again: policy_hash") == 1
    assert hashes[0] != hashes[1]
    assert json.loads(summaries[0].read_text())["policy_hash"] == hashes[1]  # of the same weights
    assert (jobs[0] / "metrics.csv").read_bytes() == log

    other = train(tmp_path, *words, "algorithm.gamma=0.9")
    assert other.returncode == 2
    assert "algorithm.gamma is 0.98 there and 0.9 here" in other.stderr
