"""A metric is one row: files, comparisons and reports follow, and a user's own is one of them."""

import json

import numpy as np
import pytest
from evaluated import HIT, LATE, WON, write_evaluation
from omegaconf import OmegaConf

from navrl.evaluation import METRICS, EpisodeRecord, compare, find_evaluations, metrics_markdown
from navrl.evaluation.metrics import Metric
from navrl.evaluation.results import COLUMNS, summarize, write_results
from navrl.factory.metrics import make_metrics
from navrl.untrusted import DamagedFileError

STEPS = Metric("my_steps", "1/s", lambda t: 2.0 * t.num_steps, "lower", True, "successes")
IDLE = Metric("idle", "1", lambda t: t.num_steps > 9, "lower", True, is_rate=True)


def records(outcomes):
    return [
        EpisodeRecord(
            index,
            "office",
            outcome,
            steps=index + 1,
            time_s=0.2 * (index + 1),
            path_length_m=1.0,
            min_pedestrian_distance_m=1.0,
            metrics={} if outcome == "error" else {"my_steps": 2.0 + index, "idle": index % 2},
        )
        for index, outcome in enumerate(outcomes)
    ]


def write(folder, policy, outcomes):
    folder.mkdir(parents=True)
    played, metrics = records(outcomes), (*METRICS, STEPS, IDLE)
    settings = {"suite": "mine", "suite_hash": "abc", "simulator": "BatchedSimulator"}
    summary = summarize(played, policy=policy, **settings, metrics=metrics)
    return write_results(folder, played, summary, metrics)


def test_own_metric_is_a_column_and_a_summary(tmp_path):
    summary = write(tmp_path / "a", "mine", [WON, WON, HIT, "error"])
    header, *rows = (tmp_path / "a" / "episodes.csv").read_text().splitlines()[:4]
    assert header.split(",") == [*COLUMNS[:-1], "my_steps", "idle", "error"]
    assert [row.split(",")[-3:-1] for row in rows] == [
        ["2.000000", "0"],
        ["3.000000", "1"],
        ["4.000000", "0"],
    ]
    assert summary["metrics"]["my_steps"]["successes"]["mean"] == 2.5
    assert summary["metrics"]["my_steps"]["over"] == "successes"
    assert summary["metrics"]["idle"]["all"]["n"] == 4  # an error is a 0 of a rate
    assert "over" not in summary["metrics"]["spl"]


def test_own_metric_is_compared_without_its_function(tmp_path):
    write(tmp_path / "a", "mine", [WON, WON, HIT, LATE])
    write(tmp_path / "b", "paper", [WON, HIT, WON, LATE])
    (table,) = compare(find_evaluations([tmp_path]))
    (row,) = (row for row in table.rows if row.policy == "mine")
    found = {metric.name: metric for metric in row.metrics}
    assert (found["my_steps"].own.value, found["my_steps"].over) == (2.5, "successes")
    assert (found["my_steps"].better, found["my_steps"].unit) == ("lower", "1/s")
    assert found["my_steps"].difference.n == 1  # both reach the goal in episode 0 alone
    assert found["idle"].own.low == pytest.approx(0.15, abs=1e-3)  # Wilson, 2 of 4
    assert "| `my_steps` | `mine` | 2.5 1/s | 2 |" in metrics_markdown(table, ["my_steps"])


def test_a_run_without_the_metric_is_compared_by_the_others(tmp_path):
    write(tmp_path / "a", "mine", [WON, HIT])
    write_evaluation(
        tmp_path / "b", "paper", [WON, HIT], suite="mine", simulator="BatchedSimulator"
    )
    for table in compare(find_evaluations([tmp_path])):
        for row in table.rows:
            assert ("my_steps" in {m.name for m in row.metrics}) == (row.policy == "mine")


@pytest.mark.parametrize(
    "key, value, message",
    [
        ("unit", "<b>", "unit='<b>': must be"),
        ("over", "runs", "over='runs': must be one of 'episodes', 'successes'"),
        ("is_rate", 1, "is_rate='1': must be true or false"),
        ("of_error", "0", "of_error='0': must be a number or null"),
    ],
)
def test_facts_from_a_foreign_summary_are_checked(tmp_path, key, value, message):
    write(tmp_path / "a", "mine", [WON])
    file = tmp_path / "a" / "summary.json"
    summary = json.loads(file.read_text())
    summary["metrics"]["my_steps"][key] = value
    file.write_text(json.dumps(summary))
    with pytest.raises(DamagedFileError, match=r"metrics\.my_steps: ") as error:
        find_evaluations([tmp_path])
    assert message in str(error.value)


def test_config_adds_metrics_and_rejects_other_objects():
    def node(target, **options):
        return OmegaConf.create({"metrics": {"mine": {"_target_": target, **options}}})

    metric = "navrl.evaluation.metrics.Metric"
    function = {"_target_": "hydra.utils.get_method", "path": "numpy.sum"}
    own = node(metric, name="mine", unit="s", function=function)
    assert [m.name for m in make_metrics(own)] == [*(m.name for m in METRICS), "mine"]
    with pytest.raises(ValueError, match=r"name='success' is a column"):
        make_metrics(node(metric, name="success", unit="s", function=function))
    with pytest.raises(ValueError, match=r"mine=dict: must be a navrl\.evaluation"):
        make_metrics(node("builtins.dict"))


def test_metric_of_a_wrong_shape_is_rejected():
    class Two:
        def __len__(self):
            return 2

    with pytest.raises(ValueError, match=r"metric mine: must return \[2\] numbers, .* \[\]"):
        Metric("mine", "1", lambda t: np.float64(1.0)).values(Two())


def test_metric_needs_a_function_and_a_row():
    """Columns, comparisons, collisions, endings and the docs table have no list of their own."""
    from navrl.evaluation import pairing, results
    from navrl.viz.report.endings import ENDINGS

    compared = tuple(m.name for m in METRICS if m.compared)
    assert pairing.COMPARABLE[: len(compared)] == compared
    assert set(results.COLUMNS) >= {m.name for m in METRICS}
    assert {m.name: (m.label, m.color) for m in METRICS if m.is_ending}.items() <= ENDINGS.items()
