"""Tables of robustness: rates, tests against the nominal run, order of rows and columns."""

import csv

import pytest
from evaluated import HIT, WON, write_evaluation

from navrl.evaluation import (
    find_evaluations,
    mcnemar_p_value,
    robustness_markdown,
    robustness_tables,
    wilson_interval,
    write_robustness,
)
from navrl.evaluation.comparison import compare
from navrl.untrusted import DamagedFileError

NOMINAL = [WON] * 18 + [HIT] * 2
LATE = [WON] * 8 + [HIT] * 12
SLOW = [WON] * 17 + [HIT] * 3


def perturbation(name, kind):
    return {"name": name, "kind": kind, "about": f"about {name}"}


@pytest.fixture
def folder(tmp_path):
    for name, kind, outcomes in (
        ("wheels_1", "base", SLOW),
        ("nominal", "nominal", NOMINAL),
        ("scan_01", "time", LATE),
    ):
        changes = {"perturbation": perturbation(name, kind)}
        write_evaluation(tmp_path / name / "paper", "paper", outcomes, **changes)
        changes["privileged"] = True
        write_evaluation(tmp_path / name / "oracle", "oracle", [WON] * 20, **changes)
    write_evaluation(tmp_path / "none" / "paper", "paper", NOMINAL)
    return tmp_path


def test_table_has_perturbations_as_rows_by_kind(folder):
    (table,) = robustness_tables(find_evaluations([folder]))
    assert [row.name for row in table.rows] == ["nominal", "scan_01", "wheels_1"]
    assert list(table.policies) == ["paper", "oracle"] and table.privileged == {"oracle"}


def test_rates_are_tested_against_the_nominal_run(folder):
    (table,) = robustness_tables(find_evaluations([folder]))
    nominal, late, slow = (row.rates["paper"] for row in table.rows)
    assert (nominal.difference, nominal.p_value) == (None, None)
    assert late.rate == 0.4 and late.difference == -0.5
    assert late.interval == wilson_interval(8, 20)
    won = [[outcome == WON for outcome in outcomes] for outcomes in (LATE, NOMINAL, SLOW)]
    assert late.p_value == mcnemar_p_value(won[0], won[1])
    assert slow.p_value == mcnemar_p_value(won[2], won[1]) == 1.0
    assert late.p_holm == 2 * late.p_value  # two tests of the policy


def test_markdown_marks_rates_that_do_not_differ(folder):
    (table,) = robustness_tables(find_evaluations([folder]))
    lines = robustness_markdown(table).splitlines()
    assert "| | perturbation | `paper` | `oracle`\\* |" in lines
    assert any(line.startswith("| `wheels_1` | about wheels_1 | 85.0~ [") for line in lines)
    assert any(line.startswith("| `scan_01` | about scan_01 | 40.0 [") for line in lines)
    assert "`abc`" in robustness_markdown(table)


def test_csv_has_a_row_for_each_policy_and_perturbation(folder):
    _, file = write_robustness(robustness_tables(find_evaluations([folder])), folder)
    rows = list(csv.DictReader(file.open()))
    assert len(rows) == 6
    late = next(r for r in rows if (r["perturbation"], r["policy"]) == ("scan_01", "paper"))
    assert float(late["success_rate"]) == 0.4 and float(late["difference"]) == -0.5


def test_policy_without_a_perturbation_has_an_empty_cell(folder):
    changes = {"perturbation": perturbation("scan_01", "time")}
    write_evaluation(folder / "more", "dwa", SLOW, **changes)
    (table,) = robustness_tables(find_evaluations([folder]))
    assert table.rows[0].rates.keys() == {"paper", "oracle"}
    assert "\N{EN DASH}" in robustness_markdown(table)
    assert table.rows[1].rates["dwa"].difference is None  # without a nominal run


def test_perturbed_evaluations_have_tables_of_their_own(folder):
    tables = compare(find_evaluations([folder]))
    assert {table.suite for table in tables} == {
        *("table1", "table1 under nominal", "table1 under scan_01", "table1 under wheels_1")
    }
    perturbed = next(table for table in tables if table.suite == "table1 under scan_01")
    assert all(not row.published for row in perturbed.rows)


def test_damaged_perturbation_is_named(tmp_path):
    write_evaluation(tmp_path / "a", "paper", NOMINAL, perturbation={"name": 3})
    with pytest.raises(DamagedFileError, match="perturbation="):
        find_evaluations([tmp_path])
