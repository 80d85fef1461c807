"""When a finished evaluation is returned, and when it is played again."""

import json
import os
import shutil

import pytest
import torch
from nightly import mostly
from safetensors.torch import load_file, save_file

from navrl.config import CONF_DIR, compose
from navrl.evaluation import find_evaluations
from navrl.jobs import evaluation as building
from navrl.jobs import finished_evaluation, inputs, measure_latency, run_evaluation
from navrl.policies import ZOO

TINY = [
    *("suite=smoke", "suite.num_episodes=3", "num_worlds=3", "num_threads=1"),
    *("environment.time_limit_steps=6", "progress_bar=false"),
]


def config(policy, *overrides):
    return compose("evaluate", [*TINY, f"policy={policy}", *overrides])


def played(folder, *overrides, policy="random"):
    cfg = config(policy, *overrides)
    assert finished_evaluation(cfg, folder) is None
    return cfg, run_evaluation(cfg, folder)


@pytest.fixture
def bundle(tmp_path):
    folder = tmp_path / "bundle"
    shutil.copytree(ZOO / "no_temporal", folder)
    return folder


def test_an_unchanged_evaluation_is_returned(tmp_path, bundle):
    cfg, summary = played(tmp_path / "run", policy=str(bundle))
    assert finished_evaluation(cfg, tmp_path / "run") == summary
    assert summary == json.loads((tmp_path / "run" / "summary.json").read_text())
    assert {"policy_hash", "config_hash", "code_hash", "episodes_hash"} <= summary.keys()


def test_older_weights_of_another_policy_are_evaluated(tmp_path, bundle):
    cfg, _ = played(tmp_path / "run", policy=str(bundle))
    file = bundle / "weights.safetensors"
    save_file({name: value * 0 for name, value in load_file(file).items()}, file)
    os.utime(file, (0, 0))  # older than the evaluation
    assert finished_evaluation(cfg, tmp_path / "run") is None


def test_changed_bundle_config_is_evaluated(tmp_path, bundle):
    cfg, _ = played(tmp_path / "run", policy=str(bundle))
    text = (bundle / "config.yaml").read_text()
    assert "max_speed: 1.0" in text
    (bundle / "config.yaml").write_text(text.replace("max_speed: 1.0", "max_speed: 0.5"))
    os.utime(bundle / "config.yaml", (0, 0))
    assert finished_evaluation(cfg, tmp_path / "run") is None


def test_file_time_does_not_cause_a_repetition(tmp_path, bundle):
    cfg, summary = played(tmp_path / "run", policy=str(bundle))
    os.utime(bundle / "weights.safetensors")  # newer, the same bytes
    assert finished_evaluation(cfg, tmp_path / "run") == summary


def test_changed_controller_parameters_are_evaluated(tmp_path, monkeypatch):
    controllers = tmp_path / "conf" / "controller"
    shutil.copytree(CONF_DIR, tmp_path / "conf")
    monkeypatch.setattr("navrl.config.CONF_DIR", tmp_path / "conf")
    cfg, _ = played(tmp_path / "run", policy="pure_pursuit")
    file = controllers / "pure_pursuit.yaml"
    file.write_text(file.read_text().replace("waypoint: 1", "waypoint: 3"))
    assert finished_evaluation(cfg, tmp_path / "run") is None


def test_changed_code_is_evaluated(tmp_path, monkeypatch):
    cfg, _ = played(tmp_path / "run")
    monkeypatch.setattr(inputs, "code_hash", lambda: "other")
    assert finished_evaluation(cfg, tmp_path / "run") is None


def test_code_hash_covers_controllers_and_not_pictures(tmp_path, monkeypatch):
    before = inputs.source_hash(inputs.PACKAGE)
    copy = tmp_path / "navrl"
    shutil.copytree(inputs.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    assert inputs.source_hash(copy) == before
    with (copy / "viz" / "rates.py").open("a") as file:
        file.write("\n")
    assert inputs.source_hash(copy) == before
    with (copy / "policies" / "classical" / "pure_pursuit.py").open("a") as file:
        file.write("\n")
    assert inputs.source_hash(copy) != before


@pytest.mark.parametrize("name", ["episodes.csv", "summary.json"])
@pytest.mark.parametrize("damage", mostly(["missing", "torn", "empty", "altered"], ["altered"]))
def test_damaged_results_are_evaluated_again(tmp_path, name, damage):
    folder = tmp_path / "run"
    cfg, summary = played(folder)
    file = folder / name
    whole = file.read_bytes()
    file.unlink()
    if damage == "torn":
        file.write_bytes(whole[: len(whole) // 2])
    elif damage == "empty":
        file.write_bytes(b"")
    elif damage == "altered":
        file.write_bytes(
            whole.replace(b",timeout,", b",success,").replace(b'"config_hash": "', b'"c": "')
        )
    assert finished_evaluation(cfg, folder) is None
    assert run_evaluation(cfg, folder) == summary
    assert file.read_bytes() == whole
    assert finished_evaluation(cfg, folder) == summary


def test_results_without_hashes_are_evaluated_again(tmp_path):
    cfg, summary = played(tmp_path)
    older = {name: value for name, value in summary.items() if not name.endswith("_hash")}
    older["suite_hash"] = summary["suite_hash"]
    (tmp_path / "summary.json").write_text(json.dumps(older))
    assert finished_evaluation(cfg, tmp_path) is None


@pytest.mark.slow
def test_unfinished_episodes_of_other_parameters_are_repeated(tmp_path, monkeypatch):
    """What was cut off before a controller's file changed is no part of the result."""
    controllers = tmp_path / "conf" / "controller"
    shutil.copytree(CONF_DIR, tmp_path / "conf")
    monkeypatch.setattr("navrl.config.CONF_DIR", tmp_path / "conf")
    monkeypatch.setattr(building, "finish", lambda folder: None)  # as a kill before the end leaves
    words = ("environment.time_limit_steps=60",)
    played(tmp_path / "run", *words, policy="pure_pursuit")
    file = controllers / "pure_pursuit.yaml"
    file.write_text(file.read_text().replace("waypoint: 1", "waypoint: 4"))
    cfg = config("pure_pursuit", *words)
    assert finished_evaluation(cfg, tmp_path / "run") is None
    assert run_evaluation(cfg, tmp_path / "run") == run_evaluation(cfg, tmp_path / "fresh")


def test_files_of_other_results_are_removed(tmp_path, bundle):
    folder = tmp_path / "run"
    cfg, _ = played(folder, "recordings=all", "latency=1", policy=str(bundle))
    measure_latency(cfg, folder)
    (folder / "errors").mkdir()
    (folder / "errors" / "000001.json").write_text("{}")
    (folder / "recordings" / "000009.npz").write_bytes(b"of other episodes")
    file = bundle / "weights.safetensors"
    save_file({name: value * 0 for name, value in load_file(file).items()}, file)
    assert finished_evaluation(cfg, folder) is None
    run_evaluation(cfg, folder)
    assert not (folder / "errors").exists() and not (folder / "latency.json").exists()
    assert len(list((folder / "recordings").iterdir())) == 3


def test_missing_recordings_are_created(tmp_path):
    cfg, _ = played(tmp_path, "recordings=all")
    (tmp_path / "recordings" / "000001.npz").unlink()
    assert finished_evaluation(cfg, tmp_path) is None
    run_evaluation(cfg, tmp_path)
    shutil.rmtree(tmp_path / "recordings")
    assert finished_evaluation(config("random", "recordings=failures"), tmp_path) is None
    assert finished_evaluation(config("random"), tmp_path) is not None


def test_no_recordings_are_missing_without_failures(tmp_path, monkeypatch):
    cfg, summary = played(tmp_path, "recordings=failures", policy="stand_still")
    assert summary["successes"] == 0
    assert finished_evaluation(cfg, tmp_path) == summary


@pytest.mark.slow
def test_changed_number_of_timed_episodes_is_timed(tmp_path):
    cfg, _ = played(tmp_path, "latency=1", policy="stand_still")
    first = measure_latency(cfg, tmp_path)
    assert first["calls"] == 5 and measure_latency(cfg, tmp_path) == first
    assert measure_latency(config("stand_still", "latency=2"), tmp_path)["calls"] == 10
    (tmp_path / "latency.json").write_text('{"calls": 1')
    assert measure_latency(config("stand_still", "latency=2"), tmp_path)["calls"] == 10


def test_episodes_of_another_summary_are_rejected(tmp_path):
    played(tmp_path / "run")
    file = tmp_path / "run" / "episodes.csv"
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join(lines[:-1]))
    with pytest.raises(ValueError, match=r"run/episodes.csv: .* summary.json"):
        find_evaluations([tmp_path])


def test_equal_weights_have_an_equal_policy_hash(tmp_path, bundle):
    torch.manual_seed(0)
    copy = tmp_path / "copy"
    shutil.copytree(bundle, copy)
    hashes = [inputs.policy_hash(inputs.policy_parts(config(str(p)))) for p in (bundle, copy)]
    assert hashes[0] == hashes[1]
