"""Decisions are timed beside the results, which do not change."""

import json

import pytest
from nightly import mostly

from navrl.config import compose
from navrl.jobs import measure_latency, run_evaluation

TINY = [
    *("suite=smoke", "suite.num_episodes=3", "num_worlds=3", "num_threads=1"),
    *("environment.time_limit_steps=8", "progress_bar=false"),
]


def config(*overrides):
    return compose("evaluate", [*TINY, *overrides])


@pytest.mark.parametrize("policy", mostly(["paper", "oracle", "stand_still"], ["paper"]))
def test_first_decision_of_an_episode_is_not_timed(policy, tmp_path):
    cfg = config(f"policy={policy}", "latency=2")
    run_evaluation(cfg, tmp_path)
    before = (tmp_path / "summary.json").read_bytes()
    found = measure_latency(cfg, tmp_path)
    rows = (tmp_path / "episodes.csv").read_text().splitlines()[1:3]
    steps = [int(row.split(",")[3]) for row in rows]
    assert found["calls"] == sum(steps) - 2
    assert 0 < found["median_ms"] <= found["p95_ms"] <= found["max_ms"]
    assert json.loads((tmp_path / "latency.json").read_text()) == found
    assert measure_latency(cfg, tmp_path) == found  # not measured again
    assert (tmp_path / "summary.json").read_bytes() == before


def test_latency_is_measured_only_on_request(tmp_path):
    assert measure_latency(config("policy=stand_still"), tmp_path) is None
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match=r"latency=-1: .* >= 0"):
        measure_latency(config("policy=stand_still", "latency=-1"), tmp_path)
    everything = measure_latency(config("policy=stand_still", "latency=99"), tmp_path)
    assert everything["calls"] == 3 * 7
