"""The page on own algorithms: its scripts train, and their policies are evaluated."""

import json
import re
import runpy
import sys

import pages
import pytest

PAGE = pages.ROOT / "docs" / "own_algorithm.md"
TINY = ["suite.num_episodes=2", "num_worlds=2", "environment.time_limit_steps=3"]
TINY += ["progress_bar=false", "num_threads=1", "hydra.run.dir=mine"]
# What the scripts are shortened by.
SHORTER = {
    r"NUM_WORLDS, STEPS, FRAMES = .*": "NUM_WORLDS, STEPS, FRAMES = 2, 8, 32",
    r"NUM_WORLDS, BATCH, FRAMES = .*": "NUM_WORLDS, BATCH, FRAMES = 2, 4, 16",
    r"// 64\)": "// 4)",
    r'navrl\.make\("quick", ': 'navrl.make(["pool_size=2", "num_threads=1"], ',
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    for name, text in pages.files(PAGE).items():
        for long, short in SHORTER.items():
            text = re.sub(long, short, text)
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("networks", None)


def test_scripts_are_shortened():
    texts = "".join(pages.files(PAGE).values())
    assert all(re.search(long, texts) for long in SHORTER)


@pytest.mark.parametrize("name", ["ppo", "sac", "ddpg"])
def test_script_trains(here, name, capsys):
    runpy.run_path(f"{name}.py")
    assert capsys.readouterr().out
    assert (here / f"{name}.pt").stat().st_size > 100_000


def test_trained_policy_is_evaluated(here):
    runpy.run_path("ppo.py")
    (command,) = [line for line in pages.commands(PAGE) if "networks:TrainedPolicy" in line]
    pages.run(command, *TINY)
    summary = json.loads((here / "mine" / "summary.json").read_text())
    assert (summary["policy"], summary["errors"]) == ("TrainedPolicy", 0)
    assert summary["observes"] == ["scan", "pose", "path"]


def test_experiment_of_soft_actor_critic_trains(here):
    with pages.undrawn():
        pages.run("navrl-train experiment=sac", *pages.TINY_TRAINING, "hydra.run.dir=run")
    header, *rows = (here / "run" / "metrics.csv").read_text().splitlines()
    assert rows and "alpha" in header
    assert (here / "run" / "policy" / "weights.safetensors").is_file()


def test_experiment_of_ppo_has_an_update_per_rollout(here):
    of_replay = ("replay.", "schedule.learning", "schedule.frames_per_update", "behavior.")
    words = [word for word in pages.TINY_TRAINING if not word.startswith(of_replay)]
    words += ["replay.num_steps=4", "schedule.frames_per_update=8", "hydra.run.dir=run"]
    with pages.undrawn():
        pages.run("navrl-train experiment=ppo", *words)
    header, *rows = (here / "run" / "metrics.csv").read_text().splitlines()
    assert "kl_approx" in header
    assert rows[0].startswith("8,1,") and rows[-1].startswith("16,2,")  # 2 worlds, 4 steps
    assert (here / "run" / "policy" / "weights.safetensors").is_file()
