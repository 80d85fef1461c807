"""Every controller that is configured plays, by the way that navrl-evaluate goes."""

import csv
import importlib.util

import pytest

from navrl.build import run_evaluation
from navrl.config import CONF_DIR, compose

NAMES = sorted(path.stem for path in (CONF_DIR / "controller").glob("*.yaml"))
SHORT = ["suite=smoke", "suite.num_episodes=3", "num_worlds=2", "environment.time_limit_steps=8"]
SHORT += ["num_threads=1", "progress_bar=false", "transforms.icp_align.max_iterations=5"]


@pytest.mark.parametrize("name", NAMES)
def test_plays_a_suite(name, tmp_path):
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
