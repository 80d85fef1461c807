"""A run that is killed and resumed ends exactly where an undisturbed one ends."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
import torch
from nightly import mostly
from runs import TINY, tiny_trainer

from navrl import keys
from navrl.policies import load_bundle
from navrl.training import CheckpointError, TrainingStoppedError

RUN = [
    *("schedule.total_frames=200", "replay.capacity=100"),
    *("schedule.evaluate_every_updates=8", "schedule.log_every_updates=6"),
]


class KilledError(Exception):
    pass


def rows(folder):
    """Return all of the log that is not measured by a clock."""
    if not (folder / "metrics.csv").exists():
        return []
    with (folder / "metrics.csv").open() as file:
        found = list(csv.DictReader(file))
    timed = ("seconds/", "speed/")
    return [{k: v for k, v in row.items() if not k.startswith(timed)} for row in found]


def kill(trainer, name, when, after=False):
    """Let a method of ``trainer`` raise, as a ``kill -9`` would end it, before or after it ran."""
    method = getattr(trainer, name)

    def killed(*args):
        if not after and when():
            raise KilledError
        result = method(*args)
        if after and when():
            raise KilledError
        return result

    setattr(trainer, name, killed)
    with pytest.raises(KilledError):
        trainer.run()


def assert_same_run(got, expected):
    a, b = (vars(trainer.progress) | {"seconds": 0} for trainer in (got, expected))
    assert a == b
    weights = got.algorithm.state_dict()["loss"]
    for name, value in expected.algorithm.state_dict()["loss"].items():
        assert torch.equal(value, weights[name]), name
    assert rows(got.folder) == rows(expected.folder)
    scores = [
        json.loads((t.folder / "policy" / "metrics.json").read_text()) for t in (got, expected)
    ]
    assert scores[0] | {"seconds": 0} == scores[1] | {"seconds": 0}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    trainer = tiny_trainer(tmp_path_factory.mktemp("whole"), RUN)
    trainer.run()
    return trainer


@pytest.mark.parametrize(
    "frames", mostly([0, 156], [156])
)  # at 156 the replay has wrapped around once
def test_resumed_run_equals_an_uninterrupted_one(tmp_path, whole, frames):
    broken = tiny_trainer(tmp_path, RUN)
    kill(broken, "_collect", when=lambda: broken.progress.frames >= frames)
    resumed = tiny_trainer(tmp_path, RUN)
    resumed.run()
    assert_same_run(resumed, whole)


@pytest.mark.slow
def test_correlated_noise_resumes_bit_for_bit(tmp_path):
    run = [*RUN, "schedule.total_frames=120", "exploration=correlated"]
    whole = tiny_trainer(tmp_path / "whole", run)
    whole.run()
    broken = tiny_trainer(tmp_path / "broken", run)
    kill(broken, "_collect", when=lambda: broken.progress.frames >= 60)
    assert broken.collector.state_dict()["carrier"][keys.EXPLORATION_NOISE].std() > 0.1
    resumed = tiny_trainer(tmp_path / "broken", run)
    resumed.run()
    assert_same_run(resumed, whole)


@pytest.mark.slow
def test_training_ends_after_its_seconds(tmp_path):
    trainer = tiny_trainer(tmp_path, [*RUN, "schedule.total_seconds=1e-3"])
    trainer.run()
    assert trainer.progress.frames == 4 and trainer.progress.seconds >= 1e-3  # one step of 4 worlds


@pytest.mark.slow
@pytest.mark.parametrize(
    "moment", mostly(["evaluated", "before the save", "after the save"], ["before the save"])
)
def test_kill_at_the_final_evaluation_adds_no_row(tmp_path, whole, moment):
    broken = tiny_trainer(tmp_path, RUN)
    final_row = lambda: len(rows(tmp_path)) == len(rows(whole.folder))  # noqa: E731
    if moment == "evaluated":
        kill(broken, "_evaluate", when=final_row, after=True)
    else:
        kill(broken, "_save", when=final_row, after=moment == "after the save")
    resumed = tiny_trainer(tmp_path, RUN)
    resumed.run()
    assert_same_run(resumed, whole)


@pytest.mark.slow
def test_signal_during_a_video_adds_no_row(tmp_path, whole):
    stopped = tiny_trainer(tmp_path, RUN)

    def video(frames):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.0)

    stopped.video = video
    with pytest.raises(TrainingStoppedError, match="stopped by SIGTERM"):
        stopped.run()
    assert rows(tmp_path)[-1]["evaluation/success_rate"]
    resumed = tiny_trainer(tmp_path, RUN)
    resumed.run()
    assert_same_run(resumed, whole)


@pytest.mark.slow
def test_last_frame_is_evaluated_once(tmp_path):
    due = ["schedule.evaluate_every_updates=5", "schedule.learning_starts=44"]  # at 80 and 120
    trainer, _ = rated(tmp_path, [0.5] * 3, due)
    trainer.run()
    evaluated = [r["frames"] for r in rows(tmp_path) if r["evaluation/success_rate"]]
    assert evaluated == ["80", "120"]


SHORT = ["schedule.total_frames=120", "schedule.evaluate_every_updates=4"]


def rated(folder, rates, overrides=()):
    """Return a trainer whose evaluations give ``rates``, and the rates of the saved policies."""
    trainer, saved = tiny_trainer(folder, [*SHORT, *overrides]), []
    given, save = iter(rates), trainer.on_best
    trainer.evaluate = lambda max_dynamic: {"success_rate": next(given)}

    def on_best(metrics):
        saved.append(metrics["success_rate"])
        save(metrics)

    trainer.on_best = on_best
    return trainer, saved


@pytest.mark.slow
def test_only_a_better_policy_is_saved(tmp_path):
    trainer, saved = rated(tmp_path, [0.25, 0.25, 0.5])
    trainer.run()
    assert saved == [0.25, 0.5]


@pytest.mark.slow
def test_policy_of_the_last_validation_is_kept(tmp_path):
    trainer, saved = rated(tmp_path, [0.25, 0.5, 0.375])
    trainer.run()
    metrics = json.loads((tmp_path / "policy_last" / "metrics.json").read_text())
    assert saved == [0.25, 0.5] and metrics["success_rate"] == 0.375
    assert metrics["updates"] == trainer.progress.updates
    last = load_bundle(tmp_path / "policy_last").actor.state_dict()
    trained = trainer.algorithm.state_dict()["loss"]
    for name, value in last.items():
        weights = [w for key, w in trained.items() if key == f"actor_network_params.{name}"]
        assert len(weights) == 1 and torch.equal(weights[0], value), name


def test_resume_keeps_the_best_policy(tmp_path):
    """The saved policy may be newer than the checkpoint; workers start other episodes then."""
    options = ["schedule.checkpoint_every_s=1000"]
    trainer, saved = rated(tmp_path, [0.25, 0.5], options)
    kill(trainer, "_collect", when=lambda: saved == [0.25, 0.5])
    resumed, saved = rated(tmp_path, [0.375, 0.4, 0.5], options)
    resumed.run()
    assert saved == []
    metrics = json.loads((tmp_path / "policy" / "metrics.json").read_text())
    assert metrics["success_rate"] == 0.5 and metrics["curriculum_level"] == 0
    assert resumed.progress.best_success_rate == 0.5


@pytest.mark.slow
def test_policy_of_a_higher_level_is_kept_after_a_resume(tmp_path):
    options = ["schedule.checkpoint_every_s=1000", "curriculum.levels=[1,2]"]
    trainer, saved = rated(tmp_path, [0.75, 0.25], options)
    kill(trainer, "_collect", when=lambda: saved == [0.75, 0.25])
    resumed, saved = rated(tmp_path, [0.75, 0.125, 0.375], options)
    resumed.run()
    assert saved == [0.375]


@pytest.mark.slow
def test_missing_policy_is_saved_again(tmp_path):
    trainer, saved = rated(tmp_path, [0.5, 0.25, 0.25])
    kill(trainer, "_collect", when=lambda: saved == [0.5] and trainer.progress.updates > 6)
    for file in (tmp_path / "policy").iterdir():
        file.unlink()
    (tmp_path / "policy").rmdir()
    resumed, saved = rated(tmp_path, [0.125, 0.25])
    resumed.run()
    assert saved == [0.125, 0.25]


SIGNALS = [(signal.SIGTERM, "step"), (signal.SIGINT, "evaluation")]


@pytest.mark.parametrize(("number", "moment"), mostly(SIGNALS, SIGNALS[:1]))
def test_signal_saves_the_run_and_ends_it(tmp_path, whole, number, moment):
    trainer = tiny_trainer(tmp_path, [*RUN, "schedule.checkpoint_every_s=1000"])
    step, evaluate = trainer.collector.step, trainer.evaluate

    def interrupted(*args):
        if trainer.progress.updates >= 8:
            os.kill(os.getpid(), number)
        return step(*args) if moment == "step" else evaluate(*args)

    if moment == "step":
        trainer.collector.step = interrupted
    else:
        trainer.evaluate = interrupted
    with pytest.raises(TrainingStoppedError, match=f"stopped by {number.name} after") as stop:
        trainer.run()
    assert f"resume={tmp_path} continues" in str(stop.value)
    resumed = tiny_trainer(tmp_path, RUN)
    resumed.run()
    assert_same_run(resumed, whole)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_signal_to_a_run_with_workers_saves_it(tmp_path, number):
    """A terminal or a scheduler sends it to the workers, too."""
    words = [*TINY, "collector=process", "schedule.total_frames=1000000", "hydra.run.dir=run"]
    command = [sys.executable, "-m", "navrl.cli.train", *words]
    process = subprocess.Popen(
        command, cwd=tmp_path, start_new_session=True, stderr=subprocess.PIPE, text=True
    )
    log, deadline = tmp_path / "run" / "metrics.csv", time.monotonic() + 300
    while not log.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(process.pid, number)
    told = process.communicate(timeout=120)[1]
    assert process.returncode == 128 + number
    (line,) = [line for line in told.splitlines() if "torchrl" not in line]
    assert line.startswith(f"navrl: stopped by {number.name} after ")
    trainer = tiny_trainer(tmp_path / "run", ["collector=process"])
    trainer._restore()
    assert trainer.progress.frames > 40


def test_run_without_state_does_not_restart(tmp_path, whole):
    shutil.copytree(whole.folder, tmp_path / "run")
    (tmp_path / "run" / "checkpoint" / "state.pt").unlink()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(CheckpointError, match=r"state\.pt: missing"):
        tiny_trainer(tmp_path / "run").run()
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_checkpoints_without_the_new_keys_resume(tmp_path, whole):
    """Older checkpoints: no digest, no window, no number of rows."""
    broken = tiny_trainer(tmp_path, RUN)
    kill(broken, "_collect", when=lambda: broken.progress.frames >= 156)
    store = broken.checkpoints
    state = store.load()
    for name in ("window", "log_rows"):
        del state[name]
    for name in ("evaluated_frames", "evaluated_updates"):
        del state["progress"][name]
    state["replay"]["chunks"] = [chunk[:2] for chunk in state["replay"]["chunks"]]
    torch.save(state, store.folder / "state.pt")
    resumed = tiny_trainer(tmp_path, RUN)
    resumed.run()
    assert [r["frames"] for r in rows(tmp_path)] == [r["frames"] for r in rows(whole.folder)]
    for name, value in whole.algorithm.state_dict()["loss"].items():
        assert torch.equal(value, resumed.algorithm.state_dict()["loss"][name]), name


def test_non_finite_values_are_saved_and_stop_the_run(tmp_path):
    trainer = tiny_trainer(tmp_path, RUN)
    sample = trainer.replay.sample

    def poisoned(count):
        batches = sample(count)
        batches["next", "reward"][0, 0] = float("inf")
        return batches

    trainer.replay.sample = poisoned
    with pytest.raises(FloatingPointError, match="not finite") as caught:
        trainer.run()
    assert "not_finite.pt" in caught.value.__notes__[0]
    state = torch.load(tmp_path / "not_finite.pt", weights_only=True)
    assert torch.isinf(state["batch"]["next"]["reward"]).any()


@pytest.mark.slow
def test_sigkill_discards_at_most_one_interval(tmp_path):
    folder = tmp_path / "run"
    script = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[2])\n"
        "from runs import tiny_trainer\n"
        "if __name__ == '__main__': tiny_trainer(Path(sys.argv[1])).run()"
    )
    command = [sys.executable, "-c", script, str(folder), os.path.dirname(__file__)]
    process = subprocess.Popen(command)
    state = folder / "checkpoint" / "state.pt"
    deadline = time.monotonic() + 120
    while not state.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.3)
    process.send_signal(signal.SIGKILL)
    process.wait()
    resumed = tiny_trainer(folder)
    assert resumed.run().frames == 480
