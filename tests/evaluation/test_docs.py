"""The page on evaluation says what the code does."""

import re
from pathlib import Path

import pytest

from navrl.evaluation import METRICS
from navrl.evaluation.metrics import markdown_table
from navrl.evaluation.results import COLUMNS
from navrl.worlds import frozen_episodes

PAGE = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text()


def test_every_metric_has_a_definition_and_unit():
    assert PAGE.count("<!-- metrics -->") == 1  # where the site puts the table
    table = markdown_table()
    rows = re.findall(r"^\| `([\w.]+)` \| (\S+) \| \S.* \| \S.* \|$", table, re.M)
    units = [(m.name, m.unit.replace("^2", "²").replace("^3", "³")) for m in METRICS]
    assert rows == units


def test_every_column_is_documented():
    metrics = {metric.name for metric in METRICS}
    assert all(f"`{column}`" in PAGE for column in set(COLUMNS) - metrics)


@pytest.mark.parametrize(
    "name, suite, count",
    [
        ("table1", "table1", 1000),
        ("table1_200", "table1", 200),
        ("validation", "validation", 200),
        ("open_space", "open_space", 1000),
        ("social", "social", 400),
    ],
)
def test_documented_hashes_equal_the_frozen_episodes(name, suite, count):
    (printed,) = re.findall(rf"^{name} +([0-9a-f]{{64}})$", PAGE, re.M)
    assert printed == frozen_episodes(suite, 1).sha256[count]
