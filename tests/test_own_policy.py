"""The page on own policies: each of its kinds plays the printed command."""

import json
import shutil
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pages
import pytest

import navrl  # noqa: F401  registers the environment

PAGE = pages.ROOT / "docs" / "own_policy.md"
COMMANDS = pages.commands(PAGE)
TINY = ["suite=smoke", "suite.num_episodes=2", "num_worlds=2", "environment.time_limit_steps=3"]
TINY += ["progress_bar=false", "num_threads=1", "hydra.run.dir=run"]

COMPARISON = ("outputs/evaluate/mine", "outputs/evaluate/paper")


@pytest.fixture
def here(tmp_path, monkeypatch):
    for name, text in pages.files(PAGE).items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("my_policies", None)


def evaluate(part, *more):
    """Run the one printed evaluation with this part; return its summary."""
    command = next(line for line in COMMANDS if part in line and "navrl-evaluate" in line)
    shutil.rmtree("run", ignore_errors=True)
    pages.run(command, *TINY, *more)
    summary = json.loads(Path("run/summary.json").read_text())
    assert summary["errors"] == 0
    return summary["policy"], summary["observes"]


def test_every_command_of_the_page_is_run_here():
    parts = ["my_policies:ahead", "my_policies:KeepDistance", "network.onnx", "ppo.zip", "td3.zip"]
    parts += ["process:python3 follow.py", "tcp://localhost:5555", *COMPARISON]
    for command in COMMANDS:
        assert any(part in command for part in parts), command


def test_function_and_class_are_evaluated(here):
    everything = ["scan", "pose", "path", "odometry"]
    assert evaluate("my_policies:ahead") == ("ahead", everything)
    assert evaluate("my_policies:KeepDistance") == ("KeepDistance", ["scan"])


@pytest.mark.slow
def test_own_policy_is_compared_with_the_papers(here, capsys):
    mine, paper, compared = [line for line in COMMANDS if any(part in line for part in COMPARISON)]
    for command in (mine, paper):
        pages.run(command, "suite.num_episodes=2", *TINY[2:-1])
    pages.run(compared)
    assert "| `KeepDistance` | 2 |" in capsys.readouterr().out


def test_process_is_evaluated_and_played(here):
    limit = "environment.time_limit_steps=150"
    assert evaluate("process:python3 follow.py", limit) == ("follow", ["pose", "path"])
    (play,) = [line for line in COMMANDS if line.startswith("navrl-play")]
    pages.run(play, "environment.time_limit_steps=3", "num_threads=1", "hydra.run.dir=play")
    assert Path("play/episode.gif").is_file()


@pytest.mark.slow
def test_following_process_reaches_goals_without_pedestrians(here):
    empty = ["suite.distribution.num_dynamic=[0,0]", "suite.distribution.num_static=[0,0]"]
    empty += ["suite.version=null", "environment.time_limit_steps=300"]
    evaluate("process:python3 follow.py", *empty)
    assert json.loads(Path("run/summary.json").read_text())["timeout_rate"] == 0.0


def test_network_is_evaluated(here):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    weights = onnx.numpy_helper.from_array(np.zeros((180, 2), np.float32), "weights")
    for name in ("ranges_pooled", "obs"):
        graph = helper.make_graph(
            [helper.make_node("MatMul", [name, "weights"], ["action"])],
            "policy",
            [helper.make_tensor_value_info(name, kind, ["N", 180])],
            [helper.make_tensor_value_info("action", kind, ["N", 2])],
            [weights],
        )
        opset = [helper.make_opsetid("", 17)]
        onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), "network.onnx")
        (command,) = [
            line
            for line in COMMANDS
            if "network.onnx" in line and ("inputs.obs" in line) == (name == "obs")
        ]
        shutil.rmtree("run", ignore_errors=True)
        pages.run(command, *TINY)
        summary = json.loads(Path("run/summary.json").read_text())
        assert (summary["policy"], summary["observes"]) == ("network", ["scan"])
        assert summary["errors"] == 0


@pytest.mark.parametrize("name", ["PPO", "TD3"])
def test_stable_baselines3_model_is_evaluated(here, name):
    sb3 = pytest.importorskip("stable_baselines3")
    env = gymnasium.make("navrl/Navigation-v0", overrides=["scenario=corridor", "pool_size=2"])
    getattr(sb3, name)("MultiInputPolicy", env).save(f"{name.lower()}.zip")
    assert evaluate(f"{name.lower()}.zip") == (name.lower(), ["scan", "pose", "path"])
