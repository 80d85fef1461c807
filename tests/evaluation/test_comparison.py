import csv
import io
import json

import pytest
from evaluated import HIT, LATE, WON, write_evaluation

from navrl.evaluation import (
    comma_separated,
    compare,
    find_evaluations,
    markdown,
    write_comparison,
)


def rows_of(table):
    return {row.policy: row for row in table.rows}


def test_differences_are_paired_over_the_same_episodes(tmp_path):
    # paper alone wins 8 episodes, dwa alone wins 1: exact McNemar p = 2 * (1 + 9) / 2 ** 9
    write_evaluation(tmp_path / "a", "paper", [WON] * 10 + [HIT] * 2)
    write_evaluation(tmp_path / "b", "dwa", [HIT] * 8 + [WON, WON, WON, LATE])
    (table,) = compare(find_evaluations([tmp_path]))
    row = rows_of(table)["dwa"]
    assert row.difference == pytest.approx(-7 / 12)
    assert row.p_value == pytest.approx(20 / 512)
    assert row.rates == {"success": 3 / 12, "collision": 8 / 12, "timeout": 1 / 12}
    low, high = row.intervals["timeout"]
    assert (low, high) == pytest.approx((0.0149, 0.3539), abs=1e-4)  # Wilson, by hand
    reference = rows_of(table)["paper"]
    assert reference.difference is None and reference.p_value is None
    assert [r.policy for r in table.rows] == ["paper", "dwa"]  # the best first


def test_times_are_compared_over_the_episodes_that_both_won(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON, WON, WON, HIT])  # 10, 11, 12 s
    write_evaluation(tmp_path / "b", "dwa", [HIT, WON, WON, WON], delay_s=[0.0, 1.0, 2.0, 9.0])
    write_evaluation(tmp_path / "c", "random", [HIT] * 4)
    (table,) = compare(find_evaluations([tmp_path]))
    time = rows_of(table)["dwa"].time_difference
    assert (time.value, time.n) == (pytest.approx(1.5), 2)
    assert 1.0 <= time.low <= 1.5 <= time.high <= 2.0
    assert rows_of(table)["random"].time_difference is None
    assert "+1.5 s [" in markdown(table)


def test_seeds_are_gathered(tmp_path):
    for seed, won in enumerate((2, 3, 4)):
        outcomes = [WON] * won + [HIT] * (4 - won)
        write_evaluation(tmp_path / f"p{seed}", f"paper_seed_{seed}", outcomes)
    write_evaluation(tmp_path / "one", "no_tagd_seed_0", [WON] * 4)
    (table,) = compare(find_evaluations([tmp_path]))
    (row,) = table.seeds
    assert (row.policy, row.runs, row.least, row.most) == ("paper", 3, 0.5, 1.0)
    assert row.interval[0] <= row.success <= row.interval[1]
    assert row.success == pytest.approx(0.75)
    assert "| `paper` | 3 | 75.0 % [" in markdown(table)


def test_only_the_same_episodes_in_the_same_simulator_share_a_table(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON] * 4)
    write_evaluation(tmp_path / "b", "paper", [WON] * 4, simulator="BulletSimulator")
    write_evaluation(tmp_path / "c", "paper", [WON] * 4, suite_hash="other")
    tables = compare(find_evaluations([tmp_path]))
    assert [(t.suite_hash, t.simulator) for t in tables] == [
        ("abc", "BatchedSimulator"),
        ("abc", "BulletSimulator"),
        ("other", "BatchedSimulator"),
    ]


def test_runs_of_a_seed_are_compared_with_the_reference_of_that_seed(tmp_path):
    write_evaluation(tmp_path / "a", "paper_seed_0", [WON] * 4)
    write_evaluation(tmp_path / "b", "paper_seed_1", [HIT] * 4)
    write_evaluation(tmp_path / "c", "no_tagd_seed_1", [WON, WON, WON, HIT])
    (table,) = compare(find_evaluations([tmp_path]))
    row = rows_of(table)["no_tagd_seed_1"]
    assert row.difference == pytest.approx(3 / 4)
    assert row.published["success"] == 0.85  # the paper's NO-TAGD


def test_published_figures_stand_beside_ours(tmp_path):
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


def test_the_three_files_say_the_same(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON] * 3)
    write_evaluation(tmp_path / "b", "oracle", [WON, WON, "error"])
    tables = compare(find_evaluations([tmp_path]))
    files = write_comparison(tables, tmp_path)
    assert [file.name for file in files] == [
        "comparison.md",
        "comparison.csv",
        "comparison.json",
    ]
    assert "`oracle`\\*" in files[0].read_text()
    assert "3 (1 errors)" in files[0].read_text()
    rows = list(csv.DictReader(io.StringIO(files[1].read_text())))
    assert [row["policy"] for row in rows] == ["paper", "oracle"]
    assert rows[1]["cheats"] == "1" and rows[0]["success_difference"] == ""
    (stored,) = json.loads(files[2].read_text())
    assert [row["rates"]["success"] for row in stored["rows"]] == [1.0, pytest.approx(2 / 3)]
    assert comma_separated(tables) == files[1].read_text()


def test_without_the_reference_nothing_is_compared(tmp_path):
    write_evaluation(tmp_path / "a", "dwa", [WON])
    (table,) = compare(find_evaluations([tmp_path]), reference="paper")
    assert table.reference is None
    assert "McNemar" not in markdown(table)


def test_a_folder_without_evaluations_is_named(tmp_path):
    with pytest.raises(ValueError, match="no evaluation there"):
        find_evaluations([tmp_path / "nowhere"])
