"""``navrl-evaluate -m policy=all``: one folder a policy, one table, nothing played twice."""

import json
import shlex

import pages
import pytest
from omegaconf import OmegaConf

from navrl.config import compose, folder_name
from navrl.factory import bundle_folder
from navrl.jobs import claim_folder
from navrl.jobs.sweeps import CompareEvaluations, expand_policies
from navrl.policies.classical import Orca

TINY = [
    "suite=smoke",
    *("suite.num_episodes=3", "num_worlds=3", "num_threads=1"),
    *("environment.time_limit_steps=8", "progress_bar=false"),
    "hydra.sweep.dir=sweep",
]


@pytest.fixture
def evaluate(tmp_path, monkeypatch, capfd):
    """Return a function that runs a sweep in the test's folder and returns what it printed."""
    monkeypatch.chdir(tmp_path)

    def run(*overrides):
        status = pages.exit_status(shlex.join(["navrl-evaluate", "-m", *TINY, *overrides]))
        printed, errors = capfd.readouterr()
        assert status == 0, errors[-3000:]
        return printed

    return run


def test_group_words_expand_to_existing_policies():
    everything = expand_policies(["all"])
    assert {"paper", "pure_pursuit", "oracle"} <= set(everything)
    assert all(bundle_folder(name) for name in expand_policies(["zoo"]))
    assert expand_policies(["pure_pursuit", "controllers", "mine"])[0] == "pure_pursuit"
    assert expand_policies(["pure_pursuit", "controllers"]).count("pure_pursuit") == 1
    assert expand_policies(["mine"]) == ["mine"]


def test_controller_without_its_library_is_skipped(monkeypatch, caplog):
    monkeypatch.setattr(Orca, "requires", ("no_such_module",))
    assert "orca" not in expand_policies(["all"])
    assert "no_such_module" in caplog.text
    assert expand_policies(["orca"]) == ["orca"]  # asked for by name: the error is its own


def test_sweep_without_a_result_has_no_table(tmp_path, caplog):
    caplog.set_level("INFO")
    sweep = OmegaConf.create({"hydra": {"sweep": {"dir": str(tmp_path)}}})
    CompareEvaluations().on_multirun_end(sweep)
    assert caplog.messages == ["no job of the sweep has a result"]


def test_sweep_prints_one_table_and_repeats_no_job(tmp_path, evaluate):
    first = evaluate("policy=pure_pursuit,stand_still")
    (job,) = (tmp_path / "sweep").glob("*/pure_pursuit")
    assert (job / "summary.json").is_file()
    before = (job / "summary.json").stat().st_mtime_ns
    assert "| `pure_pursuit` | 3 |" in first

    again = evaluate("policy=pure_pursuit,random,stand_still")
    assert (job / "summary.json").stat().st_mtime_ns == before
    assert "finished before" in again
    (table,) = json.loads((tmp_path / "sweep" / "comparison.json").read_text())
    assert {row["policy"] for row in table["rows"]} == {"pure_pursuit", "random", "stand_still"}
    assert (tmp_path / "sweep" / "comparison.md").is_file()
    assert (tmp_path / "sweep" / "comparison.csv").is_file()


def test_folder_of_another_configuration_is_rejected(tmp_path):
    claim_folder(compose("evaluate", ["policy=random"]), tmp_path)
    claim_folder(compose("evaluate", ["policy=random", "num_threads=1"]), tmp_path)
    with pytest.raises(ValueError, match="policy is random there and dwa here"):
        claim_folder(compose("evaluate", ["policy=dwa"]), tmp_path)


def test_folder_names_are_short_and_distinct():
    assert folder_name("table1", "", None, "seed=1,a.b=2") == "table1_seed=1,a.b=2"
    assert folder_name("outputs/train/mine") == "outputs-train-mine"
    long = [folder_name("x" * 300 + end) for end in "ab"]
    assert len(set(long)) == 2 and max(map(len, long)) <= 120
    assert folder_name("speed=[0.4,0.6]") == "speed=0.4,0.6"
    assert folder_name("../..") == "job"


@pytest.mark.slow
def test_one_word_sweeps_over_suites(tmp_path, evaluate):
    words = ["sweep=speed", "policy=stand_still", "suite=speed_corridor,speed_office"]
    words += ["suite.distribution.speed=[0.2,0.2],[1.0,1.0]", *TINY[1:-1]]
    evaluate(*words, "hydra.sweep.dir=outputs/evaluate/speed")
    tables = json.loads((tmp_path / "outputs/evaluate/speed/comparison.json").read_text())
    assert {table["suite"] for table in tables} == {
        *("speed_corridor_0.2", "speed_corridor_1.0", "speed_office_0.2", "speed_office_1.0")
    }


def test_a_sweep_over_suites_trains_nothing(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert pages.exit_status("navrl-train -m sweep=speed") == 2
    assert "policy" in capfd.readouterr().err.splitlines()[-1]
    assert not list(tmp_path.rglob("metrics.csv"))
