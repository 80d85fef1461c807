"""Timing, quartiles, bars, exponents and the report, on numbers that are known."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from navrl.benchmarks import Bar, Budget, Report, Row, Series, Task, alternate, fit_exponents
from navrl.benchmarks.results import PUBLISHED, at_most, number


def test_tasks_alternate_in_both_orders_after_warm_up():
    order = []

    def work(name):
        def run():
            order.append(name)
            return 1

        return Task(run)

    alternate({"a": work("a"), "b": work("b")}, Budget(seconds=1e-9, repeats=3))
    assert order == ["a", "b", "a", "b", "b", "a", "a", "b"]


def test_rate_is_units_per_second():
    def work():
        time.sleep(0.02)
        return 10

    rates = alternate({"sleep": Task(work)}, Budget(seconds=0.05, repeats=2))["sleep"]
    assert rates.shape == (2,)
    assert (rates <= 500).all()  # a busy machine sleeps longer, never shorter


def test_preparation_time_is_not_measured(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    calls = []

    def spend(name, seconds):
        calls.append(name)
        clock[0] += seconds
        return 1

    task = Task(lambda: spend("work", 0.5), prepare=lambda: spend("prepare", 3.0))
    rates = alternate({"work": task}, Budget(seconds=1.0, repeats=3))
    assert calls == ["prepare", "work"] * 7
    assert rates["work"].tolist() == [2.0] * 3


def test_each_task_sets_and_restores_its_threads():
    before, seen = torch.get_num_threads(), []

    def work():
        seen.append(torch.get_num_threads())
        return 1

    alternate({"one": Task(work, 1), "two": Task(work, 2)}, Budget(1e-9, 1))
    assert seen == [1, 2, 1, 2]
    assert torch.get_num_threads() == before


@pytest.mark.parametrize("wrong", [{"seconds": 0.0}, {"repeats": 0}])
def test_empty_budget_is_rejected(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Budget(**{"seconds": 1.0, "repeats": 1, **wrong})


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.5, 1.0, 2.0])
def test_exponent_of_a_power_law_is_exact(exponent):
    sizes = [8, 16, 64, 100, 256]
    costs = np.stack([3.0 * np.array(sizes, float) ** exponent, 5.0 * np.array(sizes) ** 1.5])
    np.testing.assert_allclose(fit_exponents(sizes, costs), [exponent, 1.5], atol=1e-12)


def test_exponent_of_a_noisy_power_law_is_close():
    generator = np.random.default_rng(0)
    sizes = np.array([1, 4, 16, 64, 256, 1024])
    costs = sizes**0.8 * np.exp(generator.normal(0, 0.05, (50, 6)))
    found = fit_exponents(sizes, costs)
    assert abs(found.mean() - 0.8) < 0.005
    assert found.std() < 0.02


@pytest.mark.parametrize(
    ("sizes", "costs"), [([4], [1.0]), ([4, 4], [1.0, 2.0]), ([1, 2], [1.0]), ([0, 2], [1.0, 2.0])]
)
def test_data_without_an_exponent_is_rejected(sizes, costs):
    with pytest.raises(ValueError, match=r"sizes|positive"):
        fit_exponents(sizes, np.array(costs))


def test_median_quartiles_and_limits_are_exact():
    row = Row("key", "label", "/s", [4.0, 1.0, 2.0, 3.0, 5.0], Bar(3.0))
    assert row.median == 3.0
    assert row.spread == (2.0, 4.0)
    assert row.is_met
    assert not Row("key", "label", "ms", [3.1], at_most(3.0)).is_met
    assert Row("key", "label", "ms", [2.9], at_most(3.0)).is_met
    assert Row("key", "label", "ms", [2.9]).is_met is None


@pytest.mark.parametrize("values", [[], [1.0, float("nan")], [float("inf")]])
def test_row_without_finite_numbers_is_rejected(values):
    with pytest.raises(ValueError, match="speed"):
        Row("speed", "label", "/s", values)


def make_report():
    report = Report({"processor": "a chip", "cores": 2})
    report.add(Row("scan", "scans", "/s", [12_345.6], Bar(30_000)), "peer: not installed")
    report.add(Series("boxes", "a step", "boxes", "µs", [8, 32], np.array([[1.0, 2.0]])))
    return report


def test_table_shows_all_rows_aligned():
    text = make_report().table()
    lines = [line for line in text.splitlines() if line.startswith("|")]
    assert len({len(line) for line in lines}) == 1
    assert "a chip" in text and "left out: peer: not installed" in text
    assert "12,346" in lines[2] and "≥ 30,000" in lines[2] and "NO" in lines[2]
    assert "0.5" in lines[3]  # a series has its row: cost doubles while boxes quadruple


def test_report_round_trips_through_json(tmp_path):
    make_report().save(tmp_path / "report.json")
    plain = json.loads((tmp_path / "report.json").read_text())
    assert [row["key"] for row in plain["rows"]] == ["scan", "growth.boxes"]
    assert plain["rows"][0]["met"] is False
    assert plain["rows"][1]["median"] == pytest.approx(0.5)
    assert plain["series"][0]["median"] == [1.0, 2.0]
    assert plain["skipped"] == ["peer: not installed"]


def test_a_row_is_reported_once():
    report = make_report()
    with pytest.raises(ValueError, match="scan"):
        report.add(Row("scan", "again", "/s", [1.0]))


@pytest.mark.parametrize(
    ("value", "text"), [(1234567.8, "1,234,568"), (999.6, "1,000"), (12.345, "12.3"), (0.5, "0.5")]
)
def test_numbers_are_formatted_without_exponents(value, text):
    assert number(value) == text


@pytest.mark.parametrize(("ratio", "is_warned"), [(0.66, True), (2000.0, True), (150.0, False)])
def test_deviation_from_published_figure_is_warned(ratio, is_warned):
    report = Report({}, factor=5.0)
    report.add(Row("scan.ratio", "… 1 core / PyBullet", "x", [ratio]))
    text = report.table()
    assert ("warning: scan.ratio" in text) == is_warned
    assert report.to_dict()["rows"][0]["published"] == PUBLISHED["scan.ratio"]
    assert "warning" not in Report({}, report.rows).table()  # without a factor


def test_published_figures_equal_the_documented_ones():
    page = (Path(__file__).parents[2] / "docs" / "benchmark.md").read_text()
    cells = [line.split(" | ") for line in page.partition("## Measured")[2].splitlines()]
    medians = [
        float(row[1].replace(",", "")) for row in cells if len(row) == 6 and row[1][0].isdigit()
    ]
    assert set(PUBLISHED.values()) <= set(medians)
    assert {key.partition(".")[0] for key in PUBLISHED} == {"scan", "step", "peers"}
