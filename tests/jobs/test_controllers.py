"""Every controller that is configured plays, by the way that navrl-evaluate goes."""

import csv
import importlib.util

import numpy as np
import pytest
from nightly import mostly

from navrl.config import CONF_DIR, compose
from navrl.evaluation.recording import Recording
from navrl.jobs import run_evaluation

NAMES = sorted(path.stem for path in (CONF_DIR / "controller").glob("*.yaml"))
SHORT = ["suite=smoke", "suite.num_episodes=3", "num_worlds=2", "environment.time_limit_steps=8"]
SHORT += ["num_threads=1", "progress_bar=false", "transforms.icp_align.max_iterations=5"]


@pytest.mark.parametrize("name", mostly(NAMES, ["dwa", "oracle", "pure_pursuit"]))
def test_controller_plays_a_suite(name, tmp_path):
    if name == "orca" and importlib.util.find_spec("pyrvo") is None:
        pytest.skip("needs the extra orca")
    summary = run_evaluation(compose("evaluate", [f"policy={name}", *SHORT]), tmp_path)
    assert (summary["episodes"], summary["errors"]) == (3, 0)
    with (tmp_path / "episodes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["solved"] for row in rows} == ({"0"} if name == "oracle" else {""})
    moved = [float(row["path_length_m"]) for row in rows]
    assert name in ("stand_still", "oracle") or min(moved) > 0.1


def test_a_controller_can_be_changed_from_the_command_line(tmp_path):
    change = "+change.controller.num_turn_rates=4"
    with pytest.raises(Exception, match="num_turn_rates=4"):
        run_evaluation(compose("evaluate", ["policy=dwa", change, *SHORT]), tmp_path)


EMPTY = ["suite=table1", "suite.name=empty", "suite.version=null", "suite.num_episodes=20"]
EMPTY += ["suite.distribution.num_dynamic=[0,0]", "suite.distribution.num_static=[0,0]"]
EMPTY += ["num_worlds=20", "num_threads=1", "progress_bar=false"]


def test_stop_and_go_reaches_the_goal_without_pedestrians(tmp_path):
    summary = run_evaluation(compose("evaluate", ["policy=stop_and_go", *EMPTY]), tmp_path)
    assert summary["success_rate"] == 1.0


def test_dynamic_window_reaches_full_speed_with_slow_wheels(tmp_path):
    """Each command is within reach of the last one; from rest alone it is at most 0.4 m/s."""
    cfg = compose("evaluate", ["policy=dwa", "robot=kobuki_wheeled", *EMPTY, "recordings=all"])
    run_evaluation(cfg, tmp_path)
    recordings = [Recording.load(file) for file in (tmp_path / "recordings").glob("*.npz")]
    fastest = [recording.action[:, 0].max() for recording in recordings]
    assert len(fastest) == 20
    assert min(fastest) > 0.99
    gain = max(np.diff(recording.action[:, 0]).max() for recording in recordings)
    assert gain <= 0.4 + 1e-6  # 2 m/s^2 for 0.2 s
