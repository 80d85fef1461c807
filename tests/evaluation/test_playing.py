"""An evaluation is the same in one process or several, cut off or not, recorded or not."""

import csv
import json
import multiprocessing.forkserver
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from nightly import mostly

from navrl.config import compose
from navrl.evaluation import METRICS, EpisodeRecord, Trajectory, measure
from navrl.evaluation.recording import Recording
from navrl.evaluation.rounding import restored, rounded
from navrl.evaluation.unfinished import FinishedChunks
from navrl.factory import EvaluatedPolicy
from navrl.jobs import evaluation as building
from navrl.jobs import run_evaluation
from navrl.processes import worker_context
from navrl.worlds import Scenario

SHORT = ["suite=smoke", "num_worlds=2", "num_threads=1", "progress_bar=false"]
SHORT += ["environment.time_limit_steps=12", "+change.transforms.icp_align.max_iterations=5"]
RESULTS = ("episodes.csv", "summary.json")


def play(folder, *overrides, policy="random", simulator="batched"):
    words = [f"policy={policy}", f"simulator={simulator}", *SHORT, *overrides]
    run_evaluation(compose("evaluate", words), folder)
    return [(folder / name).read_bytes() for name in RESULTS]


@pytest.fixture(scope="module", params=mostly(["batched", "bullet"], ["batched"]))
def alone(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    return request.param, play(folder, simulator=request.param)


def test_results_do_not_depend_on_the_number_of_processes(alone, tmp_path):
    simulator, expected = alone
    found = play(tmp_path, "num_processes=2", simulator=simulator)
    assert found == expected
    assert not (tmp_path / "unfinished").exists()


def test_worlds_do_not_exceed_the_episodes(tmp_path, monkeypatch):
    counts, make = [], building.make_evaluated_policy

    def counting(cfg, **options):
        counts.append(cfg.num_worlds)
        return make(cfg, **options)

    monkeypatch.setattr(building, "make_evaluated_policy", counting)
    play(tmp_path, "num_worlds=100", "suite.num_episodes=2")
    assert max(counts) == 2


def test_server_of_worker_processes_imports_the_evaluation():
    """Or each worker would import torch again."""
    worker_context()
    assert "navrl.jobs.playing" in multiprocessing.forkserver._forkserver._preload_modules


CUT_OFF = (
    "import sys, time; from navrl.jobs import playing, run_evaluation\n"
    "from navrl.config import compose; from pathlib import Path\n"
    "save = playing.FinishedChunks.save\n"
    "def slow(*a):\n    save(*a); time.sleep(600)\n"
    "playing.FinishedChunks.save = slow\n"
    "if __name__ == '__main__':\n"
    "    run_evaluation(compose('evaluate', sys.argv[2:]), Path(sys.argv[1]))\n"
)


def start_cut_off(arguments, folder):
    """Start an evaluation that waits after its first chunk; return its process group."""
    if "num_processes=1" not in arguments:
        (folder / "cut_off.py").write_text(CUT_OFF)
        command = [sys.executable, str(folder / "cut_off.py"), *arguments]
        return subprocess.Popen(command, start_new_session=True).pid
    child = os.fork()  # as above, without importing everything again
    if child == 0:
        os.setsid()
        sys.argv = ["cut_off.py", *arguments]
        try:
            exec(CUT_OFF, {"__name__": "__main__"})
        finally:
            os._exit(1)
    return child


@pytest.mark.parametrize("processes", mostly([1, 2], [1]))
def test_killed_evaluation_resumes(alone, tmp_path, processes, request):
    """SIGKILL as soon as a chunk is finished; then the same command."""
    simulator, expected = alone
    if (simulator, processes) == ("bullet", 2) and not request.config.getoption("run_slow"):
        pytest.skip("needs --run-slow")
    words = ["policy=random", f"simulator={simulator}", *SHORT, f"num_processes={processes}"]
    folder = tmp_path / "run"
    process = start_cut_off([str(folder), *words], tmp_path)
    while not list(folder.glob("unfinished/*.json")):
        assert os.waitpid(process, os.WNOHANG) == (0, 0)
        time.sleep(0.05)
    os.killpg(process, signal.SIGKILL)
    os.waitpid(process, 0)
    (part,) = folder.glob("unfinished/*.json")
    # What is finished is believed, not played again: a mark in it reaches the result.
    records = json.loads(part.read_text())
    marked = records[0]["index"]
    records[0]["path_length_m"] = 123.0
    part.write_text(json.dumps(records))
    found = play(folder, simulator=simulator)
    rows = list(csv.DictReader((folder / "episodes.csv").read_text().splitlines()))
    assert rows[marked]["path_length_m"] == "123.000000"
    others = [line for k, line in enumerate(found[0].splitlines()) if k != marked + 1]
    assert others == [x for k, x in enumerate(expected[0].splitlines()) if k != marked + 1]


def test_finished_chunks_of_another_evaluation_are_ignored(tmp_path):
    folder, record = (
        tmp_path / "unfinished",
        EpisodeRecord(0, "office", "success", 1, 0.2, 1.0, 2.0),
    )
    first = FinishedChunks(folder, "a")
    first.save(range(0, 1), [record])
    assert FinishedChunks(folder, "a").load(range(0, 1)) == [record]
    assert FinishedChunks(folder, "a").load(range(1, 2)) is None
    assert FinishedChunks(folder, "b").load(range(0, 1)) is None
    assert FinishedChunks(folder, "a").load(range(0, 1)) is None


def test_random_episode_does_not_depend_on_the_batch(alone, tmp_path):
    simulator, expected = alone
    assert play(tmp_path, "num_worlds=3", simulator=simulator)[0] == expected[0]


class Refusing:
    """Raise where the goal is that of the episode to refuse."""

    def __init__(self, policy, goal):
        self._policy, self._goal = policy, goal

    def prepare(self, scenarios):
        if any(np.allclose(goal, self._goal) for goal in scenarios.goal.numpy()):
            raise ZeroDivisionError("not this one")
        return self._policy.prepare(scenarios)

    def __call__(self, tensordict):
        return self._policy(tensordict)


def test_failed_episode_is_stored_with_its_reproduction(tmp_path, monkeypatch):
    cfg = compose("evaluate", ["policy=random", *SHORT, "recordings=all"])
    bad = building.instantiate(cfg.suite).scenarios([3])[0]
    make = building.make_evaluated_policy

    def refusing(cfg, **options):
        evaluated = make(cfg, **options)
        policy = Refusing(evaluated.policy, bad.goal)
        return EvaluatedPolicy(evaluated.name, policy, evaluated.env)

    monkeypatch.setattr(building, "make_evaluated_policy", refusing)
    summary = run_evaluation(cfg, tmp_path)
    assert (summary["episodes"], summary["errors"]) == (6, 1)
    rows = list(csv.DictReader((tmp_path / "episodes.csv").read_text().splitlines(True)))
    assert [row["outcome"] == "error" for row in rows] == [k == 3 for k in range(6)]
    assert "ZeroDivisionError: not this one" in rows[3]["error"]
    (file,) = (tmp_path / "errors").glob("*.json")
    told = json.loads(file.read_text())
    assert (told["suite"], told["seed"], told["index"]) == ("table1", 2024, 3)
    assert told["traceback"][-1] == "ZeroDivisionError: not this one"
    assert Scenario.from_dict(told["scenario"]).to_json() == bad.to_json()
    kept = {int(path.stem) for path in (tmp_path / "recordings").glob("*.npz")}
    assert kept == {0, 1, 2, 4, 5}  # its neighbor, played once more, too


@pytest.mark.parametrize("policy", mostly(["random", "paper"], ["random"]))
@pytest.mark.parametrize("simulator", mostly(["batched", "bullet"], ["batched"]))
def test_recording_changes_no_result(tmp_path, policy, simulator):
    options = {"policy": policy, "simulator": simulator}
    plain = play(tmp_path / "plain", **options)
    assert play(tmp_path / "all", "recordings=all", **options) == plain
    assert play(tmp_path / "two", "recordings=all", "num_processes=2", **options) == plain
    names = [f"{k:06d}.npz" for k in range(6)]
    for folder in ("all", "two"):
        files = sorted((tmp_path / folder / "recordings").iterdir())
        assert [file.name for file in files] == names
    rows = csv.DictReader((tmp_path / "all" / "episodes.csv").read_text().splitlines())
    for row, name in zip(rows, names, strict=True):
        one = Recording.load(tmp_path / "all" / "recordings" / name)
        two = Recording.load(tmp_path / "two" / "recordings" / name)
        driven = np.linalg.norm(np.diff(one.pose[:, :2], axis=0), axis=1).sum()
        assert (one.outcome, one.num_steps) == (row["outcome"], int(row["steps"]))
        assert driven == pytest.approx(float(row["path_length_m"]), abs=1e-4)
        assert json.loads(one.scenario)["index"] == int(row["index"])
        assert np.array_equal(one.ranges, two.ranges)
        assert (one.spatial_attention is not None) == (policy == "paper")


@pytest.mark.parametrize("simulator", mostly(["batched", "bullet"], ["batched"]))
@pytest.mark.parametrize(
    "policy, contact",
    [("stand_still", "hit_by_pedestrian"), ("pure_pursuit", "moved_into_pedestrian")],
)
def test_metrics_of_recordings_equal_the_evaluations(tmp_path, policy, contact, simulator):
    """Every metric of every episode, whoever moved into whom, in whichever row it was played."""
    words = ["recordings=all", "environment.time_limit_steps=150", "num_worlds=6"]
    play(tmp_path, *words, policy=policy, simulator=simulator)
    rows = list(csv.DictReader((tmp_path / "episodes.csv").read_text().splitlines()))
    files = sorted((tmp_path / "recordings").iterdir())
    found = measure(Trajectory.from_recordings([Recording.load(file) for file in files], 1.0))
    for metric in METRICS:
        cells = [row[metric.name] for row in rows]
        expected = [float(cell) if cell else np.nan for cell in cells]
        assert np.allclose(found[metric.name], expected, atol=5e-7, equal_nan=True), metric.name
    assert "1" in {row[contact] for row in rows}


def test_summary_names_the_frozen_episodes(tmp_path):
    """And that it was none of them, of a suite that only has the name of one."""
    changed = ["suite.version=null", "suite.distribution.speed=[1,1]"]
    for name, words, version in (("frozen", [], 1), ("changed", changed, None)):
        play(tmp_path / name, *words, policy="stand_still")
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert (summary["suite"], summary["suite_version"]) == ("table1", version)


def test_failures_only_recordings_exclude_successes(tmp_path):
    play(tmp_path, "recordings=failures", "environment.time_limit_steps=150", policy="paper")
    rows = csv.DictReader((tmp_path / "episodes.csv").read_text().splitlines())
    lost = {int(row["index"]) for row in rows if row["outcome"] != "success"}
    kept = {int(path.stem) for path in (tmp_path / "recordings").glob("*.npz")}
    assert kept == lost
    assert len(lost) < 6


def test_compact_recording_equals_the_rounded_full_one(tmp_path):
    from navrl.jobs import record

    whole = record(compose("play", ["policy=paper", "suite=smoke", "num_threads=1"]))
    whole.save(tmp_path / "whole.npz")
    whole.save(tmp_path / "compact.npz", compact=True)
    compact = Recording.load(tmp_path / "compact.npz")
    for name, value in vars(whole).items():
        other = getattr(compact, name)
        if isinstance(value, np.ndarray):
            assert other.dtype == value.dtype and other.shape == value.shape, name
            assert np.allclose(other, value, rtol=0, atol=1.001e-4, equal_nan=True), name
    for name in ("pose", "pedestrian_boxes", "action", "tagd_valid", "path"):
        assert np.array_equal(getattr(whole, name), getattr(compact, name), equal_nan=True)
    assert np.array_equal(whole.ranges < whole.max_range, compact.ranges < whole.max_range)
    size = [(tmp_path / f"{name}.npz").stat().st_size for name in ("compact", "whole")]
    assert size[0] < 0.6 * size[1]


def test_values_out_of_range_are_not_rounded():
    far = np.array([7.0, 0.0], dtype=np.float32)
    unknown = np.array([np.nan], dtype=np.float32)
    kept = rounded({"points": far, "tagd": unknown, "ranges": far / 2})
    assert kept["points"] is far and kept["tagd"] is unknown
    assert restored(kept)["ranges"].tolist() == [3.5, 0.0]


@pytest.mark.slow
def test_drawing_a_recording_needs_no_simulator(tmp_path):
    play(tmp_path / "run", "recordings=all", "suite.num_episodes=1")
    code = (
        "import sys, navrl.jobs as b\n"
        "def no(*a, **k): raise SystemExit('played')\n"
        "b.record = no\n"
        "from navrl.cli.play import main; main()"
    )
    file = tmp_path / "run" / "recordings" / "000000.npz"
    words = [f"recording={file}", "hydra.run.dir=drawn"]
    result = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=tmp_path, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr[-2000:]
    assert (tmp_path / "drawn" / "episode.gif").stat().st_size > 1000


@pytest.mark.parametrize("word", ["num_processes=0", "recordings=some"])
def test_wrong_options_are_named(tmp_path, word):
    with pytest.raises(ValueError, match=word):
        play(tmp_path, word)


def test_simulator_noise_uses_no_shared_random_state(tmp_path):
    """Global generators have no say: neither torch's nor numpy's."""
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002
    first = play(tmp_path / "a")
    torch.manual_seed(2)
    np.random.seed(2)  # noqa: NPY002
    assert play(tmp_path / "b") == first
