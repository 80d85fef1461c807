"""What a table compares with what, and what it says of the best."""

import csv
import json

import pytest
from evaluated import HIT, LATE, WON, write_evaluation

from navrl.evaluation import (
    Evaluation,
    compare,
    find_evaluations,
    holm,
    markdown,
    metrics_markdown,
    write_comparison,
)
from navrl.evaluation.metrics import METRICS

KINDS = ("collision_wall", "collision_furniture", "moved_into_pedestrian", "hit_by_pedestrian")


def tables_of(folder, **runs):
    for name, outcomes in runs.items():
        write_evaluation(folder / name, name, outcomes)
    return compare(find_evaluations([folder]))


def rows_of(table):
    return {row.policy: row for row in table.rows}


def read(file):
    with file.open(newline="") as opened:
        return list(csv.DictReader(opened))


def test_default_reference_is_the_best_non_privileged_policy(tmp_path):
    runs = {"random": [HIT] * 4, "dwa": [WON, WON, HIT, HIT], "mine": [HIT, HIT, WON, WON]}
    (table,) = tables_of(tmp_path, oracle=[WON] * 4, **runs)
    assert table.reference == "dwa"  # as good as mine, and first by name
    rows = rows_of(table)
    assert {name: row.difference for name, row in rows.items()} == {
        "oracle": 0.5,
        "dwa": None,
        "mine": 0.0,
        "random": -0.5,
    }
    assert "success vs `dwa`" in markdown(table)


def test_only_privileged_policies_have_no_reference(tmp_path):
    (table,) = tables_of(tmp_path, oracle=[WON] * 4, orca=[WON, HIT, HIT, HIT])
    assert table.reference is None and table.lead is None


def test_reference_with_several_seeds_is_paired_by_seed(tmp_path):
    seeds = {"a_seed_0": [WON, WON, HIT, HIT], "a_seed_1": [WON] * 4}
    others = {"b_seed_0": [WON, HIT, HIT, HIT], "b_seed_1": [WON, WON, HIT, HIT]}
    others["dwa"] = [WON, WON, LATE, HIT]
    (table,) = tables_of(tmp_path, **seeds, **others)
    assert table.reference == "a"  # 0.75 over its seeds
    found = {name: row.difference for name, row in rows_of(table).items()}
    assert found == {
        "a_seed_0": None,
        "a_seed_1": None,
        "b_seed_0": -0.25,
        "b_seed_1": -0.5,
        "dwa": 0.0,  # names no seed: as seed 0
    }
    assert (table.lead.best, table.lead.second) == ("a_seed_1", "b_seed_1")  # not its own seed 0


def test_reference_without_evaluation_is_an_error(tmp_path):
    write_evaluation(tmp_path / "a", "dwa_seed_0", [WON])
    write_evaluation(tmp_path / "b", "random", [WON], suite_hash="other")
    runs = find_evaluations([tmp_path])
    with pytest.raises(ValueError, match=r"reference=paper: .* there are dwa, dwa_seed_0, random"):
        compare(runs, "paper")
    assert [table.reference for table in compare(runs, "random")] == [None, "random"]


def test_best_policy_is_tested_against_the_second(tmp_path):
    # mine alone wins 6 episodes, dwa alone none: exact McNemar p = 2 / 2 ** 6
    runs = {"mine": [WON] * 8, "dwa": [HIT] * 6 + [WON] * 2, "random": [HIT] * 8}
    (table,) = tables_of(tmp_path, oracle=[WON] * 8, paper=[HIT] * 7 + [WON], **runs)
    lead = table.lead
    assert (table.reference, lead.best, lead.second) == ("paper", "mine", "dwa")
    assert (lead.difference, lead.p_value) == (0.75, pytest.approx(2 / 64))
    low, high = lead.difference_interval
    assert 0.3 < low < 0.75 < high <= 1.0
    sentence = "The best, `mine`, against the next, `dwa`, on the same episodes: +75.0 ["
    assert sentence in markdown(table) and "p = 0.031 (McNemar" in markdown(table)
    stored = json.loads(write_comparison([table], tmp_path)[2].read_text())
    assert stored[0]["lead"]["p_value"] == pytest.approx(2 / 64)


def test_error_is_paired_as_a_failure(tmp_path):
    (table,) = tables_of(tmp_path, paper=[WON] * 6 + [HIT] * 2, dwa=["error"] * 6 + [HIT] * 2)
    row = rows_of(table)["dwa"]
    assert (row.rates["success"], row.difference) == (0.0, -0.75)
    assert row.p_value == pytest.approx(2 / 64)


def test_p_values_of_a_column_are_corrected(tmp_path):
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])  # Holm 1979
    assert holm([0.5, 0.9]) == [1.0, 1.0] and holm([]) == []
    runs = {"a": [HIT] * 6 + [WON] * 2, "b": [HIT] * 7 + [WON], "c": [WON] * 8}
    (table,) = tables_of(tmp_path, paper=[WON] * 8, **runs)
    found = {name: (row.p_value, row.p_holm) for name, row in rows_of(table).items()}
    assert found["paper"] == (None, None)
    assert found["a"] == pytest.approx((2 / 64, 4 / 64))
    assert found["b"] == pytest.approx((2 / 128, 6 / 128))
    assert found["c"] == (1.0, 1.0)
    assert "p (McNemar, Holm)" in markdown(table) and "| 0.062 |" in markdown(table)
    rows = {row["policy"]: row for row in read(write_comparison([table], tmp_path)[1])}
    told = [float(rows["a"][name]) for name in ("p_value", "p_holm")]
    assert told == pytest.approx([2 / 64, 4 / 64])


def test_unfrozen_episodes_have_no_published_figures(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON, HIT], suite_version=None, suite_hash="mine")
    write_evaluation(tmp_path / "b", "paper", [WON, HIT], suite_version=1)
    write_evaluation(tmp_path / "c", "paper", [WON, HIT], suite_hash="older")
    tables = {table.suite_hash: table for table in compare(find_evaluations([tmp_path]))}
    assert [tables[name].is_frozen for name in ("mine", "abc", "older")] == [False, True, True]
    assert tables["mine"].rows[0].published == {}
    assert markdown(tables["mine"]).startswith("### table1 (not frozen), ")
    assert metrics_markdown(tables["mine"]).startswith("#### Metrics on table1 (not frozen), ")
    for name in ("abc", "older"):
        assert tables[name].rows[0].published["success"] == 0.862
        assert markdown(tables[name]).startswith("### table1, ")
    rows = read(write_comparison(list(tables.values()), tmp_path)[1])
    assert [row["frozen"] for row in rows] == ["0", "1", "1"]


def test_metric_names_of_version_0_1_are_read_and_accepted(tmp_path):
    flags = {name: ["0"] * 2 for name in KINDS[:-1]} | {"run_into": ["0", "1"]}
    metrics = {"run_into": {"n": 2, "mean": 0.5, "compared": True}}
    folder = tmp_path / "mine"
    write_evaluation(folder, "mine", [WON, HIT], columns=flags, run_into=1, metrics=metrics)
    evaluation = Evaluation.load(folder)
    assert evaluation.summary["hit_by_pedestrian"] == 1
    assert evaluation.finite("hit_by_pedestrian") == {0: 0.0, 1: 1.0}
    assert [metric.name for metric in evaluation.metrics] == [metric.name for metric in METRICS]
    (table,) = compare([evaluation])
    assert table.rows[0].rates["hit_by_pedestrian"] == 0.5
    with pytest.warns(DeprecationWarning, match="use hit_by_pedestrian"):
        assert "hit_by_pedestrian" in metrics_markdown(table, ["run_into"])
    with pytest.warns(DeprecationWarning, match="cheats is deprecated: use is_privileged"):
        assert table.rows[0].cheats is False


def test_collisions_are_compared_by_kind(tmp_path):
    flags = {name: ["0"] * 4 for name in KINDS}
    flags["hit_by_pedestrian"] = ["0", "1", "1", ""]  # empty after an error, in files from before
    outcomes = [WON, HIT, HIT, "error"]
    write_evaluation(tmp_path / "a", "mine", outcomes, columns=flags)
    write_evaluation(tmp_path / "b", "older", [WON, WON, HIT, HIT])
    flags = {**flags, "hit_by_pedestrian": ["0"] * 4, "collision_wall": ["0", "0", "0", "1"]}
    write_evaluation(tmp_path / "c", "dwa", [WON, WON, WON, "collision_static"], columns=flags)
    (table,) = compare(find_evaluations([tmp_path]))
    rows = rows_of(table)
    assert [rows["mine"].rates[name] for name in KINDS] == [0.0, 0.0, 0.0, 0.5]
    assert rows["mine"].intervals["hit_by_pedestrian"] == pytest.approx((0.1500, 0.8500), abs=1e-4)
    assert rows["older"].rates.keys() == {"success", "collision", "timeout"}
    assert (table.reference, rows["dwa"].rates["collision_wall"]) == ("dwa", 0.25)
    text = markdown(table)
    assert "| `mine` | 0.0 % [0.0, 49.0] | 0.0 % [0.0, 49.0] | 0.0 % [0.0, 49.0] | 50.0 % [" in text
    files = write_comparison([table], tmp_path)
    by_policy = {row["policy"]: row for row in read(files[1])}
    assert (
        by_policy["mine"]["hit_by_pedestrian_rate"],
        by_policy["older"]["hit_by_pedestrian_rate"],
    ) == ("0.5", "")
    (row,) = (
        row
        for row in read(files[3])
        if (row["policy"], row["metric"]) == ("mine", "hit_by_pedestrian")
    )
    assert (row["mean"], row["mean_n"], row["common_n"]) == ("0.5", "4", "0")
    assert float(row["mean_low"]) == pytest.approx(0.15, abs=1e-4)
    assert (row["difference"], row["pairs"]) == ("0.5", "4")


def test_latencies_are_listed_beside_the_metrics(tmp_path):
    for name in ("paper", "dwa"):
        write_evaluation(tmp_path / name, name, [WON, HIT])
    told = {"mean_ms": 3.0, "median_ms": 2.5, "p95_ms": 4.5, "max_ms": 9.0, "calls": 70}
    (tmp_path / "paper" / "latency.json").write_text(json.dumps(told))
    (table,) = compare(find_evaluations([tmp_path]))
    rows = read(write_comparison([table], tmp_path)[3])
    assert [
        [row[name] for name in ("policy", "metric", "unit", "over", "mean", "mean_low", "mean_n")]
        for row in rows
    ] == [
        ["paper", "latency_median_ms", "ms", "decisions", "2.5", "", "70"],
        ["paper", "latency_p95_ms", "ms", "decisions", "4.5", "", "70"],
    ]
    assert "| `latency_p95_ms` | `paper` | 4.5 ms | 70 |" in metrics_markdown(table)
