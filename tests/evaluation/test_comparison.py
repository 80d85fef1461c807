import csv
import io
import json
import math

import pytest
from evaluated import HIT, LATE, WON, write_evaluation

from navrl.evaluation import (
    comma_separated,
    compare,
    compare_folders,
    find_evaluations,
    markdown,
    metrics_markdown,
    write_comparison,
)
from navrl.evaluation.pairing import compare_metrics, finished_by_all, success_difference
from navrl.evaluation.seeds import split_seed


def rows_of(table):
    return {row.policy: row for row in table.rows}


def test_differences_are_paired_over_the_same_episodes(tmp_path):
    # paper alone wins 8 episodes, dwa alone wins 1: exact McNemar p = 2 * (1 + 9) / 2 ** 9
    write_evaluation(tmp_path / "a", "paper", [WON] * 10 + [HIT] * 2)
    write_evaluation(tmp_path / "b", "dwa", [HIT] * 8 + [WON, WON, WON, LATE])
    (table,) = compare(find_evaluations([tmp_path]))
    assert table.reference == "paper"
    row = rows_of(table)["dwa"]
    assert row.difference == pytest.approx(-7 / 12)
    assert row.p_value == pytest.approx(20 / 512)
    assert row.rates == {"success": 3 / 12, "collision": 8 / 12, "timeout": 1 / 12}
    low, high = row.intervals["timeout"]
    assert (low, high) == pytest.approx((0.0149, 0.3539), abs=1e-4)  # Wilson, by hand
    reference = rows_of(table)["paper"]
    assert reference.difference is None and reference.p_value is None
    assert [r.policy for r in table.rows] == ["paper", "dwa"]  # the best first


def test_tables_are_separate_for_each_suite_and_simulator(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON] * 4)
    write_evaluation(tmp_path / "b", "paper", [WON] * 4, simulator="BulletSimulator")
    write_evaluation(tmp_path / "c", "paper", [WON] * 4, suite_hash="other")
    tables = compare(find_evaluations([tmp_path]))
    assert [(t.suite_hash, t.simulator) for t in tables] == [
        ("abc", "BatchedSimulator"),
        ("abc", "BulletSimulator"),
        ("other", "BatchedSimulator"),
    ]


def test_runs_are_compared_with_the_reference_of_their_seed(tmp_path):
    write_evaluation(tmp_path / "a", "paper_seed_0", [WON] * 4)
    write_evaluation(tmp_path / "b", "paper_seed_1", [HIT] * 4)
    write_evaluation(tmp_path / "c", "no_tagd_seed_1", [WON, WON, WON, HIT])
    (table,) = compare(find_evaluations([tmp_path]))
    row = rows_of(table)["no_tagd_seed_1"]
    assert row.difference == pytest.approx(3 / 4)
    assert row.published["success"] == 0.85  # the paper's NO-TAGD


def test_published_figures_are_listed_beside_results(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON, HIT])
    change = {"change": {"transforms.icp_align.method": "none"}}
    write_evaluation(tmp_path / "b", "paper", [WON, HIT], **change)
    write_evaluation(tmp_path / "c", "pure_pursuit", [HIT, HIT])
    (table,) = compare(find_evaluations([tmp_path]))
    rows = rows_of(table)
    assert rows["paper"].published == {
        "success": 0.862,
        "collision": 0.138,
        "timeout": 0.0,
        "time": 17.7,
    }
    assert rows["paper, transforms.icp_align.method=none"].published == {"success": 0.814}
    assert rows["pure_pursuit"].published == {}
    text = markdown(table)
    assert "86.2 % / 13.8 % / 0.0 % / 17.7 s" in text
    assert "50.0 % [9.5, 90.5]" in text
    assert "`abc`" in text


def test_three_comparison_files_agree(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON] * 3)
    write_evaluation(tmp_path / "b", "oracle", [WON, WON, "error"])
    tables = compare(find_evaluations([tmp_path]))
    files = write_comparison(tables, tmp_path)
    assert [file.name for file in files] == [
        "comparison.md",
        "comparison.csv",
        "comparison.json",
        "comparison_metrics.csv",
    ]
    assert "`oracle`\\*" in files[0].read_text()
    assert "3 (1 errors)" in files[0].read_text()
    rows = list(csv.DictReader(io.StringIO(files[1].read_text())))
    assert [row["policy"] for row in rows] == ["paper", "oracle"]
    assert rows[1]["privileged"] == "1" and rows[0]["success_difference"] == ""
    (stored,) = json.loads(files[2].read_text())
    assert [row["rates"]["success"] for row in stored["rows"]] == [1.0, pytest.approx(2 / 3)]
    assert comma_separated(tables) == files[1].read_text()


def test_single_policy_is_not_compared(tmp_path):
    write_evaluation(tmp_path / "a", "dwa", [WON])
    (table,) = compare(find_evaluations([tmp_path]))
    assert table.reference is None and table.lead is None
    assert "McNemar" not in markdown(table)


def test_folder_without_evaluations_is_named(tmp_path):
    with pytest.raises(ValueError, match="no evaluation there"):
        find_evaluations([tmp_path / "nowhere"])


def test_runs_of_different_episodes_are_rejected(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON] * 4)
    write_evaluation(tmp_path / "b", "dwa", [WON] * 4, suite_hash="other", suite="mine")
    with pytest.raises(ValueError, match=r"not the same episodes.*table1 \(hash abc\).*of mine"):
        compare_folders([tmp_path / "a", tmp_path / "b"])
    runs = find_evaluations([tmp_path])
    for pair in (success_difference, lambda a, b: compare_metrics(a, b, set())):
        with pytest.raises(ValueError, match="not the same episodes"):
            pair(*runs)
    with pytest.raises(ValueError, match="not the same episodes"):
        finished_by_all(runs)


def test_reference_is_the_first_or_a_named_folder(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON] * 4)
    write_evaluation(tmp_path / "b", "paper", [WON] * 3 + [HIT], simulator="BulletSimulator")
    table = compare_folders([tmp_path / "b", tmp_path / "a"])
    assert table.simulator == "BatchedSimulator and BulletSimulator"
    assert table.reference == "paper, BulletSimulator"
    assert rows_of(table)["paper, BatchedSimulator"].difference == pytest.approx(1 / 4)
    table = compare_folders([tmp_path], reference="paper, BatchedSimulator")
    assert rows_of(table)["paper, BulletSimulator"].difference == pytest.approx(-1 / 4)
    with pytest.raises(ValueError, match="reference=dwa"):
        compare_folders([tmp_path], reference="dwa")


def test_times_are_compared_where_all_succeed(tmp_path):
    # won by all: 0 and 3, which take 10 and 13 s; by the first two: 0, 1, 3
    write_evaluation(tmp_path / "a", "paper", [WON, WON, HIT, WON], time_to_goal_s="{time}")
    slow = {"time_to_goal_s": "{time}", "delay": 2.0}
    write_evaluation(tmp_path / "b", "dwa", [WON, WON, WON, WON], **slow)
    write_evaluation(tmp_path / "c", "random", [WON, HIT, HIT, WON], time_to_goal_s="{time}")
    table = compare_folders([tmp_path])
    assert table.finished_by_all == 2
    rows = rows_of(table)
    assert rows["paper"].common_time.value == pytest.approx(11.5)
    assert rows["paper"].common_time.n == 2
    assert rows["dwa"].common_time.value == pytest.approx(13.5)
    (time,) = (m for m in rows["dwa"].metrics if m.name == "time_to_goal_s")
    assert (time.unit, time.over, time.own.n, time.common.n) == ("s", "successes", 4, 2)
    assert time.own.value == pytest.approx(13.5)
    assert time.difference.value == pytest.approx(2.0)  # over 0, 1 and 3, which both win
    assert time.difference.n == 3 and math.isnan(time.difference.p_value)
    (length,) = (m for m in rows["random"].metrics if m.name == "path_length_m")
    assert (length.own.n, length.difference.n) == (2, 2)  # the way to a collision is no length
    text = metrics_markdown(table)
    assert "| `time_to_goal_s` | `dwa` | 13.5 s | 4 |" in text
    assert "| +2 | 3 | \N{EN DASH} |" in text
    assert "time where all succeed, n=2" in markdown(table)
    rows = csv.DictReader(io.StringIO((write_comparison([table], tmp_path)[3]).read_text()))
    (row,) = (r for r in rows if (r["policy"], r["metric"]) == ("dwa", "time_to_goal_s"))
    assert (row["pairs"], row["difference"]) == ("3", "2.0")
    assert (row["mean_n"], row["common_n"], row["common"]) == ("4", "2", "13.5")


def test_policy_without_success_has_no_time_to_compare(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON, WON, HIT, WON], time_to_goal_s="{time}")
    write_evaluation(tmp_path / "b", "random", [HIT, HIT, HIT, HIT], time_to_goal_s="{time}")
    table = compare_folders([tmp_path])
    assert table.finished_by_all == 3
    assert [rows_of(table)[name].common_time.n for name in ("paper", "random")] == [3, 0]
    assert all(metric.common.n == 0 for metric in rows_of(table)["random"].metrics)


def test_rows_of_one_policy_have_different_labels(tmp_path):
    lidar = {"perturbation": {"name": "rplidar_a1", "kind": "lidar", "about": "an A1"}}
    for name in ("first", "second"):
        write_evaluation(tmp_path / name, "paper", [WON, HIT])
    write_evaluation(tmp_path / "lidar", "paper", [WON, WON], **lidar)
    for name in ("one", "two"):
        write_evaluation(tmp_path / name / "evaluation", "dwa", [HIT, HIT])
    table = compare_folders([tmp_path])
    assert table.suite == "table1"
    assert {row.policy for row in table.rows} == {
        *("paper (first)", "paper (second)", "paper under rplidar_a1", "dwa (one)", "dwa (two)")
    }


def test_training_seeds_are_summarized(tmp_path):
    outcomes = ([WON] * 4, [WON, WON, HIT, HIT], [WON, WON, WON, HIT])
    for seed, played in enumerate(outcomes):
        write_evaluation(tmp_path / str(seed), f"paper_seed_{seed}", played)
    write_evaluation(tmp_path / "other", "dwa", [HIT] * 4)
    table = compare_folders([tmp_path])
    (found,) = table.seeds
    assert (found.approach, found.seeds, found.rates) == ("paper", (0, 1, 2), (1.0, 0.5, 0.75))
    assert found.success.value == pytest.approx(0.75)
    assert found.success.n == 3 and 0.5 <= found.success.low < 0.75 < found.success.high <= 1.0
    assert "| `paper` | 3 | 75.0 % [" in markdown(table)
    collision, time = found.metrics[1:]
    assert (collision.name, collision.by_seed) == ("collision_rate", (0.0, 0.5, 0.25))
    assert (collision.estimate.value, collision.worst, collision.best) == (0.25, 0.5, 0.0)
    assert (time.unit, time.by_seed) == ("s", (11.5, 10.5, 11.0))  # of successes: 10, 11, 12, 13 s
    assert (time.estimate.value, time.worst, time.best) == (11.0, 11.5, 10.5)
    assert 10.5 <= time.estimate.low < time.estimate.high <= 11.5
    assert " s [" in markdown(table) and "(11.5 to 10.5)" in markdown(table)
    files = {file.name: file for file in write_comparison([table], tmp_path / "out")}
    rows = list(csv.DictReader(io.StringIO(files["comparison_seeds.csv"].read_text())))
    assert [row["metric"] for row in rows] == ["success_rate", "collision_rate", "time_to_goal_s"]
    told = [rows[2][name] for name in ("approach", "seeds", "iqm", "worst", "best", "episodes")]
    assert told == ["paper", "3", "11.0", "11.5", "10.5", "4"]
    write_evaluation(tmp_path / "unnamed", "dwa_seed_1", [WON] * 4)
    (_, dwa) = compare_folders([tmp_path]).seeds
    assert (dwa.approach, dwa.seeds, dwa.rates) == ("dwa", (0, 1), (0.0, 1.0))
    time = dwa.metrics[2]  # no kind of world has a success of every seed
    assert math.isnan(time.estimate.value) and (time.worst, time.best) == (11.5, 11.5)
    stored = write_comparison([compare_folders([tmp_path])], tmp_path / "all")[2].read_text()
    assert json.loads(stored)[0]["seeds"][1]["metrics"][2]["by_seed"] == [None, 11.5]
    assert split_seed("outputs-seed=3") == ("outputs", 3)
    assert split_seed("no_seed_here") == ("no_seed_here", None)
