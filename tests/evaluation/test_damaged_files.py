"""Damaged files of evaluations, caches and recordings: one line with the file, or healed."""

import csv
import dataclasses
import hashlib
import json
import shutil

import numpy as np
import pytest
from evaluated import HIT, WON, write_evaluation

from navrl.config import compose, instantiate
from navrl.evaluation import find_evaluations
from navrl.evaluation.recorder import record_episode
from navrl.evaluation.recording import Recording
from navrl.evaluation.rollout import EpisodeRecord
from navrl.evaluation.stored import Evaluation, whole_results
from navrl.evaluation.unfinished import FinishedChunks
from navrl.factory import make_env, make_navigation_env
from navrl.policies.classical import StandStill
from navrl.untrusted import DamagedFileError
from navrl.worlds import FrozenEpisodes, Scenario, ScenarioPool, Suite
from navrl.worlds.frozen import FROZEN


def cut(file, share):
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])


@pytest.fixture
def folder(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON] * 5 + [HIT], time_to_goal_s="{time}")
    return tmp_path / "a"


def read_all(folder):
    (evaluation,) = find_evaluations([folder])
    return evaluation.label, evaluation.setting, evaluation.episodes, evaluation.latency


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.99])
@pytest.mark.parametrize("name", ["summary.json", "episodes.csv", "latency.json"])
def test_truncated_evaluation_file_is_named(folder, name, share):
    latency = {"calls": 40, "mean_ms": 1.5, "median_ms": 1.4, "p95_ms": 2.2, "max_ms": 3.0}
    (folder / "latency.json").write_text(json.dumps(latency))
    read_all(folder)
    cut(folder / name, share)
    with pytest.raises(DamagedFileError, match=name) as error:
        read_all(folder)
    assert "again" in str(error.value) and "\n" not in str(error.value)


def test_csv_with_missing_rows_is_named(folder):
    lines = (folder / "episodes.csv").read_text().splitlines(keepends=True)
    (folder / "episodes.csv").write_text("".join(lines[:-2]))
    with pytest.raises(DamagedFileError, match=r"episodes\.csv: has 4 episodes.*has 6"):
        read_all(folder)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("policy", 5),
        ("policy", "x" * 1000),
        ("suite", ["a"]),
        ("episodes", "6"),
        ("episodes", 1e400),
        ("success_rate", "0.9"),
        ("success_rate", 1.5),
        ("success_interval", [0.1]),
        ("navigation_time_s", '"><b>'),
        ("change", [1]),
        ("by_scenario", {"corridor": {"success_rate": 0.5}}),
        ("by_scenario", [1]),
    ],
)
def test_summary_with_values_of_a_wrong_type_is_named(folder, key, value):
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps({**summary, key: value}))
    with pytest.raises(DamagedFileError, match=rf"summary\.json: {key}"):
        Evaluation.load(folder)


def test_cell_without_a_number_is_named(folder):
    with (folder / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    rows[2]["time_s"] = "<b>12</b>"
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    with pytest.raises(DamagedFileError, match=r"episodes\.csv: row of episode 2: time_s="):
        read_all(folder)


@pytest.mark.parametrize("name", ["summary.json", "episodes.csv"])
def test_evaluation_with_a_damaged_file_is_repeated(folder, name, caplog):
    summary = json.loads((folder / "summary.json").read_text())
    played = hashlib.sha256((folder / "episodes.csv").read_bytes()).hexdigest()
    (folder / "summary.json").write_text(json.dumps({**summary, "episodes_hash": played}))
    assert whole_results(folder)["policy"] == "paper"
    cut(folder / name, 0.6)
    assert whole_results(folder) is None
    assert name in caplog.text and "played again" in caplog.text
    (folder / name).unlink()
    assert whole_results(folder) is None


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_truncated_chunk_is_repeated(tmp_path, caplog, share):
    record = EpisodeRecord(0, "corridor", "success", 3, 0.6, 0.5, 1.0, False)
    FinishedChunks(tmp_path / "chunks", "key").save(range(0, 1), [record])
    (file,) = (tmp_path / "chunks").glob("*.json")
    cut(file, share)
    assert FinishedChunks(tmp_path / "chunks", "key").load(range(0, 1)) is None
    assert file.name in caplog.text


# --- worlds --------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_truncated_world_cache_is_rebuilt(tmp_path, caplog, share):
    suite = Suite("heals", 0, 4, instantiate(compose("train", ["scenario=corridor"]).scenario))
    cache = tmp_path / "pool.npz"
    whole, content = ScenarioPool(suite, cache=cache), cache.read_bytes()
    cut(cache, share)
    again = ScenarioPool(suite, cache=cache)
    assert "pool.npz" in caplog.text and "generated again" in caplog.text
    assert np.array_equal(whole.batch.path, again.batch.path)
    assert cache.read_bytes() == content


def test_unwritable_world_cache_is_skipped(tmp_path, caplog):
    suite = Suite("heals", 0, 2, instantiate(compose("train", ["scenario=corridor"]).scenario))
    (tmp_path / "file").write_text("no folder")
    assert len(ScenarioPool(suite, cache=tmp_path / "file" / "pool.npz")) == 2
    assert "not cached" in caplog.text and "pool.npz" in caplog.text


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_truncated_frozen_suite_is_named(tmp_path, share):
    file = tmp_path / "smoke.json"
    shutil.copy(sorted(FROZEN.glob("*.json"))[0], file)
    cut(file, share)
    with pytest.raises(DamagedFileError, match=r"smoke\.json.*restore"):
        FrozenEpisodes.load(file)


# --- recordings ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording():
    cfg = compose("train", ["scenario=corridor", "network=small"])
    env = make_env(make_navigation_env(cfg, 1, privileged=True), instantiate(cfg.transforms))
    scenario = instantiate(cfg.scenario).sample("damaged", 0, 1)
    yield record_episode(env, StandStill(env.base_env.simulator.robot), scenario)
    env.close()


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_truncated_recording_is_named(tmp_path, recording, share):
    file = tmp_path / "episode.npz"
    recording.save(file)
    cut(file, share)
    with pytest.raises(DamagedFileError, match=r"episode\.npz.*again"):
        Recording.load(file)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("outcome", "<img src=x>"),
        ("outcome", 3),
        ("time_step_s", "0.2"),
        ("time_step_s", 0.0),
        ("time_step_s", float("nan")),
        ("robot_radius", float("inf")),
        ("max_range", -1.0),
        ("contact", 99),
        ("scenario", "{}"),
        ("scenario", "{"),
        ("goal", np.array(["a", "b"])),
        ("goal", np.array([0.0, np.nan])),
        ("unknown", np.zeros(3)),
    ],
)
def test_recording_with_values_of_a_wrong_type_is_named(tmp_path, recording, name, value):
    file = tmp_path / "episode.npz"
    recording.save(file)
    with np.load(file) as archive:
        stored = dict(archive)
    np.savez(file, **{**stored, name: value})
    with pytest.raises(DamagedFileError, match=rf"episode\.npz.*{name}"):
        Recording.load(file)


def test_recording_with_an_invalid_scenario_is_named(tmp_path, recording):
    plain = json.loads(recording.scenario)
    for name, value in (("suite", 5), ("kind", "x" * 1000), ("index", "<b>"), ("pedestrians", 1)):
        changed = dataclasses.replace(recording, scenario=json.dumps({**plain, name: value}))
        changed.save(tmp_path / "episode.npz")
        with pytest.raises(DamagedFileError, match=r"episode\.npz.*scenario"):
            Recording.load(tmp_path / "episode.npz")
    Scenario.from_json(recording.scenario).save(tmp_path / "scenario.json")
    cut(tmp_path / "scenario.json", 0.5)
    with pytest.raises(DamagedFileError, match=r"scenario\.json"):
        Scenario.load(tmp_path / "scenario.json")
