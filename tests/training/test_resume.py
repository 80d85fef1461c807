"""A run that is killed and resumed ends exactly where an undisturbed one ends."""

import os
import signal
import subprocess
import sys
import time

import pytest
import torch
from runs import tiny_trainer


class KilledError(Exception):
    pass


def test_a_resumed_run_continues_bit_for_bit(tmp_path):
    whole = tiny_trainer(tmp_path / "whole")
    whole.run()

    broken = tiny_trainer(tmp_path / "broken")
    collect = broken._collect

    def collect_until_killed():
        if broken.progress.frames >= 356:  # after the replay has wrapped around once
            raise KilledError
        collect()

    broken._collect = collect_until_killed
    with pytest.raises(KilledError):
        broken.run()
    resumed = tiny_trainer(tmp_path / "broken")
    resumed.run()

    assert vars(resumed.progress) | {"seconds": 0} == vars(whole.progress) | {"seconds": 0}
    expected, got = whole.algorithm.state_dict(), resumed.algorithm.state_dict()
    for name, value in expected["loss"].items():
        assert torch.equal(value, got["loss"][name]), name
    for row in ("frames", "evaluation/success_rate", "learn/q_mean", "reward/guidance"):
        assert column(tmp_path / "broken", row) == column(tmp_path / "whole", row), row


def column(folder, name):
    import csv

    with (folder / "metrics.csv").open() as file:
        return [row[name] for row in csv.DictReader(file)]


def test_not_finite_values_are_saved_and_stop_the_run(tmp_path):
    trainer = tiny_trainer(tmp_path)
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
def test_kill_minus_nine_loses_at_most_an_interval(tmp_path):
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
