"""Files of an evaluation: what is counted, and the very bytes."""

import csv
import hashlib
import json
import math
from dataclasses import replace

import pytest

from navrl.evaluation import EpisodeRecord, rates, summarize, wilson_interval, write_results
from navrl.evaluation.metrics import METRICS as METRIC_TABLE

NAMES = [metric.name for metric in METRIC_TABLE]
FIRST = dict.fromkeys(NAMES) | {
    "success": 1.0,
    "time_to_goal_s": 8.0,
    "min_time_to_collision_s": math.inf,
}
SETTING = {
    "hit_by_pedestrian": True,
    "noise_seed": 9,
    "num_dynamic": 2,
    "num_static": 1,
    "pedestrian_speed_mps": 0.6,
}
RECORDS = [
    EpisodeRecord(0, "corridor", "success", 40, 8.0, 7.123456789, 0.25, metrics=FIRST),
    EpisodeRecord(1, "office", "success", 51, 10.200000000000001, 9.5, math.inf),
    EpisodeRecord(2, "office", "collision_pedestrian", 7, 1.4000000000000001, 1.0, 0.0, **SETTING),
    EpisodeRecord(3, "corridor", "collision_static", 9, 1.8, 1.5, 0.5),
    EpisodeRecord(4, "office", "timeout", 150, 30.0, 3.0, 0.4),
    EpisodeRecord(5, "office", "error", 0, math.nan, math.nan, math.nan, False, "a\nb"),
]
METRICS = (
    "success,timeout,collision,collision_wall,collision_furniture,moved_into_pedestrian,"
    "time_to_goal_s,spl,stl,stalled_time_s,time_without_progress_s,mean_speed_mps,max_speed_mps,"
    "mean_acceleration_mps2,max_acceleration_mps2,mean_jerk_mps3,max_jerk_mps3,heading_change_rad,"
    "turn_reversal_share,speed_change_p90_mps,speed_change_p95_mps,turn_rate_change_p90_radps,"
    "turn_rate_change_p95_radps,max_turn_rate_radps,turned_per_meter_radpm,shielded_share,"
    "mean_pedestrian_distance_m,beyond_0.45m_share,beyond_1.2m_share,min_time_to_collision_s"
)
NO_METRICS = "," * METRICS.count(",")
ERROR_METRICS = f"0,0,0,0,0,0,,0.000000,0.000000{',' * 21}"  # no success, and no contact is known
CSV = f"""\
index,scenario,outcome,steps,time_s,path_length_m,min_pedestrian_distance_m,hit_by_pedestrian,solved,\
noise_seed,num_dynamic,num_static,pedestrian_speed_mps,{METRICS},error
0,corridor,success,40,8.000000,7.123457,0.250000,0,,0,0,0,,\
1,,,,,,8.000000,{"," * 22}inf,
1,office,success,51,10.200000,9.500000,inf,0,,0,0,0,,{NO_METRICS},
2,office,collision_pedestrian,7,1.400000,1.000000,0.000000,1,,9,2,1,0.600000,{NO_METRICS},
3,corridor,collision_static,9,1.800000,1.500000,0.500000,0,,0,0,0,,{NO_METRICS},
4,office,timeout,150,30.000000,3.000000,0.400000,0,,0,0,0,,{NO_METRICS},
5,office,error,0,nan,nan,nan,0,,0,0,0,,{ERROR_METRICS},"a
b"
"""


def summary(records=RECORDS):
    return summarize(records, policy="p", suite="s", suite_hash="0f", simulator="BatchedSimulator")


def test_summary_counts_every_episode():
    result = summary()
    assert result["episodes"] == 6
    assert result["success_rate"] == pytest.approx(2 / 6, abs=1e-6)
    assert result["success_interval"] == pytest.approx(wilson_interval(2, 6), abs=1e-6)
    assert result["collision_rate"] == pytest.approx(2 / 6, abs=1e-6)
    assert result["collision_pedestrian_rate"] == pytest.approx(1 / 6, abs=1e-6)
    assert result["collision_static_rate"] == pytest.approx(1 / 6, abs=1e-6)
    assert result["timeout_interval"] == pytest.approx(wilson_interval(1, 6), abs=1e-6)
    assert (result["errors"], result["hit_by_pedestrian"], result["successes"]) == (1, 1, 2)
    names = ("policy", "suite", "suite_hash", "simulator")
    assert [result[name] for name in names] == ["p", "s", "0f", "BatchedSimulator"]


def test_navigation_time_is_of_successes_only():
    assert summary()["navigation_time_s"] == pytest.approx(9.1)
    assert summary(RECORDS[2:])["navigation_time_s"] is None


def test_kinds_of_worlds_are_counted_separately():
    kinds = summary()["by_scenario"]
    assert {kind: part["episodes"] for kind, part in kinds.items()} == {"corridor": 2, "office": 4}
    assert kinds["corridor"]["success_rate"] == 0.5
    assert kinds["office"]["errors"] == 1


def test_rates_sum_to_one():
    found = rates(RECORDS)
    assert sum(found.values()) == pytest.approx(1.0)
    assert found["error_rate"] == pytest.approx(1 / 6)


def test_summary_of_no_episodes_is_rejected():
    with pytest.raises(ValueError, match="records"):
        summary([])


def test_files_have_exact_content(tmp_path):
    write_results(tmp_path / "new", RECORDS, summary())
    assert (tmp_path / "new" / "episodes.csv").read_bytes() == CSV.encode()
    text = (tmp_path / "new" / "summary.json").read_text()
    found = json.loads(text)
    assert found.pop("episodes_hash") == hashlib.sha256(CSV.encode()).hexdigest()
    assert found == summary()
    write_results(tmp_path / "again", RECORDS, summary())
    assert (tmp_path / "again" / "summary.json").read_text() == text


def test_plans_are_counted_and_written(tmp_path):
    planned = [replace(r, solved=r.outcome == "success") for r in RECORDS]
    assert summary(planned)["solved"] == 2
    assert summary(planned)["by_scenario"]["office"]["solved"] == 1
    assert "solved" not in summary()
    write_results(tmp_path, planned, summary(planned))
    with (tmp_path / "episodes.csv").open(newline="") as file:
        assert [row["solved"] for row in csv.DictReader(file)] == ["1", "1", "0", "0", "0", "0"]


def test_metrics_are_summarized_over_all_and_successes():
    played = [
        replace(r, metrics=dict.fromkeys(NAMES) | {"success": float(won), "spl": spl})
        for r, won, spl in zip(RECORDS[:4], (1, 1, 0, 0), (0.5, 1.0, 0.0, math.inf), strict=True)
    ]
    found = summary(played)["metrics"]
    assert found["success"]["all"]["n"] == 4
    assert found["success"]["all"]["mean"] == 0.5
    assert found["success"]["all"]["interval"] == pytest.approx(wilson_interval(2, 4), abs=1e-6)
    assert (found["spl"]["unit"], found["spl"]["better"]) == ("1", "higher")
    assert found["spl"]["all"]["n"] == 3  # of finite values
    assert found["spl"]["all"]["median"] == 0.5
    assert found["spl"]["successes"]["mean"] == 0.75
    assert found["spl"]["successes"]["interval"] is None  # of two values
    assert found["time_to_goal_s"]["all"] == {
        "n": 0,
        "mean": None,
        "interval": None,
        "median": None,
    }


def test_errors_count_as_failures_in_every_rate():
    values = dict.fromkeys(NAMES) | {"success": 1.0, "collision": 0.0, "spl": 1.0, "stl": 0.5}
    won = [replace(RECORDS[0], index=k, metrics=values) for k in range(3)]
    result = summary([*won, RECORDS[5]])
    found = result["metrics"]
    for metric in METRIC_TABLE:
        if metric.is_rate and values[metric.name] is not None:
            assert found[metric.name]["all"]["n"] == 4, metric.name
            assert found[metric.name]["successes"]["n"] == 3, metric.name
    assert found["success"]["all"]["mean"] == result["success_rate"] == 0.75
    assert found["success"]["all"]["interval"] == result["success_interval"]
    assert found["collision"]["all"]["mean"] == 0.0
    assert (found["spl"]["all"]["mean"], found["stl"]["all"]["mean"]) == (0.75, 0.375)
    assert found["spl"]["successes"]["mean"] == 1.0
    assert found["min_time_to_collision_s"]["all"]["n"] == 0  # nobody knows how it was driven
