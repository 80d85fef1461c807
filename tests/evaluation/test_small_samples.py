"""Statistics of few episodes or few seeds: tests keep their level, intervals have a width."""

import json
import math

import numpy as np
import pytest
from evaluated import HIT, WON, write_evaluation
from nightly import mostly
from scipy.stats import permutation_test

from navrl.evaluation import compare, find_evaluations, markdown, metrics_markdown
from navrl.evaluation.comparison import compare_folders
from navrl.evaluation.pairing import success_difference
from navrl.evaluation.statistics import (
    bootstrap_mean,
    mcnemar_p_value,
    paired_difference,
    stratified_bootstrap,
)
from navrl.evaluation.tables import write_comparison

DRAWS = 600


@pytest.mark.parametrize("pairs", mostly([6, 7, 8, 10, 12, 14, 20], [6, 7, 8]))
@pytest.mark.parametrize("shape", ["normal", "skewed"])
def test_tests_reject_in_five_percent(pairs, shape):
    """Both runs draw from one distribution; an exact test is allowed to fire less, never more."""
    rng = np.random.default_rng(pairs)
    draw = rng.normal if shape == "normal" else lambda size: rng.lognormal(0, 1, size)
    first, second = draw(size=(DRAWS, pairs)), draw(size=(DRAWS, pairs))
    found = [paired_difference(a, b) for a, b in zip(first, second, strict=True)]
    fired = np.mean([result.p_value <= 0.05 for result in found])
    excludes_zero = np.mean([result.low > 0 or result.high < 0 for result in found])
    level = 2 / 64 if pairs == 6 else 0.05  # what 64 sign flips can tell
    spread = 2.6 * math.sqrt(level * (1 - level) / DRAWS)  # 99 %
    assert level - 0.005 - spread < fired < level + spread
    assert level - 0.005 - spread < excludes_zero < level + spread


@pytest.mark.parametrize("pairs", [6, 10, 20])
def test_mcnemar_rejects_in_at_most_five_percent(pairs):
    first, second = np.random.default_rng(pairs).random((2, 2000, pairs)) < 0.5
    p_values = [mcnemar_p_value(a, b) for a, b in zip(first, second, strict=True)]
    assert np.mean(np.array(p_values) < 0.05) < 0.05 + 2.6 * math.sqrt(0.05 * 0.95 / 2000)


@pytest.mark.parametrize("pairs", [6, 9, 12])
def test_sign_flips_of_few_pairs_are_exact(pairs):
    differences = np.random.default_rng(pairs).normal(0.4, 1.0, pairs)
    expected = permutation_test((differences,), np.mean, permutation_type="samples").pvalue
    assert paired_difference(differences, np.zeros(pairs)).p_value == pytest.approx(expected)


def test_sign_flips_of_many_pairs_are_sampled():
    differences = np.random.default_rng(0).normal(0.8, 1.0, 16)
    flips = permutation_test(
        (differences,), lambda x, axis: x.mean(axis=axis), permutation_type="samples",
        n_resamples=2**16, vectorized=True, batch=4096,
    )  # fmt: skip
    found = paired_difference(differences, np.zeros(16))
    assert found.p_value == pytest.approx(flips.pvalue, abs=0.01)
    assert paired_difference(differences, np.zeros(16)) == found


@pytest.mark.parametrize("pairs", range(6))
def test_fewer_than_six_pairs_have_no_p_value(pairs):
    found = paired_difference(np.arange(pairs) + 1.0, np.zeros(pairs))
    assert all(map(math.isnan, (found.low, found.high, found.p_value)))
    assert found.n == pairs and (pairs == 0 or found.value == (pairs + 1) / 2)
    assert math.isnan(mcnemar_p_value([True] * pairs, [False] * pairs))


def test_six_equal_pairs_have_a_p_value_and_no_interval():
    found = paired_difference([2.0] * 6, [1.0] * 6)
    assert (found.value, found.p_value, found.n) == (1.0, 2 / 64, 6)
    assert math.isnan(found.low) and math.isnan(found.high)
    assert paired_difference([1.0] * 9, [1.0] * 9).p_value == 1.0


@pytest.mark.parametrize("sample", [[3.0], [3.0] * 40, [1.0, 2.0, 3.0, 4.0, 5.0]])
def test_a_mean_of_few_or_equal_values_has_no_interval(sample):
    found = bootstrap_mean(sample)
    assert found.value == 3.0 and found.n == len(sample)
    assert math.isnan(found.low) and math.isnan(found.high)


@pytest.mark.parametrize("size", [6, 8, 20])
def test_intervals_of_few_values_cover_the_mean(size):
    samples = np.random.default_rng(size).normal(5.0, 2.0, (DRAWS, size))
    found = [bootstrap_mean(sample) for sample in samples]
    covered = np.mean([estimate.low <= 5.0 <= estimate.high for estimate in found])
    assert covered > 0.95 - 2.6 * math.sqrt(0.05 * 0.95 / DRAWS)


@pytest.mark.parametrize("scores", [[[0.4, 0.6]], [[0.4], [0.6]], [[0.5], [0.5], [0.5]]])
def test_few_or_equal_seeds_have_no_interval(scores):
    found = stratified_bootstrap(np.array(scores))
    assert found.value == 0.5 and found.n == len(scores)
    assert math.isnan(found.low) and math.isnan(found.high)


def test_tables_of_four_episodes_show_no_test(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON] * 4, time_to_goal_s="{time}")
    write_evaluation(tmp_path / "b", "dwa", [WON] * 3 + [HIT], time_to_goal_s="{time}", delay=1.0)
    table = compare_folders([tmp_path])
    _, p_value = success_difference(*find_evaluations([tmp_path]))
    assert p_value is None and table.lead.p_value is None
    assert [row.p_holm for row in table.rows] == [None, None]
    text = markdown(table) + metrics_markdown(table)
    assert "nan" not in text
    assert "+25.0 points of success; no test with fewer than 6 episodes." in text
    assert "| `dwa` | 4 | 75.0 % [30.1, 95.4] |" in text
    assert "| -25.0 | \N{EN DASH} |" in text  # no interval, no p
    assert "| +1 | 3 | \N{EN DASH} |" in text
    json.loads(write_comparison([table], tmp_path)[2].read_text(), parse_constant=pytest.fail)


def test_tie_is_reported_as_a_tie(tmp_path):
    for name in ("dwa", "liang", "paper"):
        write_evaluation(tmp_path / name, name, [WON] * 6 + [HIT] * 2)
    write_evaluation(tmp_path / "random", "random", [WON] * 2 + [HIT] * 6)
    (table,) = compare(find_evaluations([tmp_path]))
    text = markdown(table)
    assert "`dwa` and `liang` tie: 75.0 % of the same episodes each." in text
    assert "against the next" not in text
    from navrl.viz.report.verdict import headline, verdict

    assert headline(table) == (
        "dwa, liang and paper succeed in 75.0 % [40.9, 92.9] of 8 episodes each"
    )
    found = verdict(table)
    assert "more than the next approach" not in found
    assert "Tied with paper: dwa, liang." in found
    assert (
        "not significant (p ≥ 0.05) by exact McNemar tests, corrected by Holm for 3: random"
        in found
    )


def test_report_of_four_episodes_claims_no_difference(tmp_path):
    pytest.importorskip("plotly", reason="needs the extra 'report'")
    from navrl.viz.report import write_report

    write_evaluation(tmp_path / "a", "paper_seed_0", [WON] * 4, time_to_goal_s="{time}")
    write_evaluation(tmp_path / "b", "paper_seed_1", [WON] * 3 + [HIT], time_to_goal_s="{time}")
    write_evaluation(tmp_path / "c", "dwa", [HIT] * 4)
    text = write_report([tmp_path], tmp_path / "report.html").read_text()
    body = text[text.rindex("<main>") : text.rindex("</main>")]
    assert "There is no test with fewer than 6 episodes." in body
    assert "significant" not in body and "chance" not in body
    assert "nan" not in body.lower().replace("finance", "")


def test_two_seeds_have_no_interval_in_tables(tmp_path):
    write_evaluation(tmp_path / "a", "mine_seed_0", [WON] * 6 + [HIT] * 2)
    write_evaluation(tmp_path / "b", "mine_seed_1", [WON] * 4 + [HIT] * 4)
    (table,) = compare(find_evaluations([tmp_path]))
    assert "| `mine` | 2 | 62.5 % (50.0 to 75.0) |" in markdown(table)
    assert "nan" not in markdown(table)


def test_values_equal_but_for_rounding_are_a_tie():
    result = paired_difference([0.1 + 0.2] * 8, [0.3] * 8)
    assert (result.value, result.p_value) == (0.0, 1.0)
