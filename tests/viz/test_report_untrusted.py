"""What strangers wrote into files is shown as text on the page, never as markup."""

import dataclasses
import html
import json
import re
import shutil
import subprocess

import pytest
from evaluated import HIT, WON, write_evaluation

from navrl.evaluation import find_evaluations, markdown, metrics_markdown
from navrl.evaluation.comparison import compare
from navrl.evaluation.spreadsheets import comma_separated, metrics_comma_separated
from navrl.files import write_text
from navrl.viz import plot_curves
from navrl.viz.report import page as page_module
from navrl.viz.report import write_report
from navrl.viz.report.episodes import episode_data

MARKUP = '"><img src=x onerror=alert(1)></script>'


def wrote(folder, **changes):
    write_evaluation(folder, "paper", [WON, HIT], time_to_goal_s="{time}", **changes)


@pytest.mark.parametrize("key", ["policy", "suite", "suite_hash", "simulator"])
def test_texts_of_a_summary_are_escaped(tmp_path, key):
    pytest.importorskip("plotly", reason="needs the report extra")
    wrote(tmp_path / "a", **{key: MARKUP} if key != "policy" else {})
    if key == "policy":
        shutil.rmtree(tmp_path / "a")
        write_evaluation(tmp_path / "a", MARKUP, [WON, HIT], time_to_goal_s="{time}")
    text = write_report([tmp_path], tmp_path / "report.html").read_text()
    page = re.sub(r"<script>.*?</script>", "", text, flags=re.S)  # navrl's own and plotly's
    assert "<img" not in page and "onerror" in html.unescape(page)
    tables = compare(find_evaluations([tmp_path]))
    for written in (markdown(tables[0]), metrics_markdown(tables[0])):
        outside_code = re.sub(r"`[^`]*`", "", written)
        assert "<img" not in outside_code


def test_worlds_and_changes_are_escaped_in_figures(tmp_path):
    pytest.importorskip("plotly", reason="needs the report extra")
    part = {"episodes": 1, "success_rate": 1.0, "success_interval": [0.2, 1.0]}
    worlds = {"<b>corridor": part, "%{x}office": part}
    wrote(tmp_path / "a", by_scenario=worlds, change={"<i>key": "<a href=x>value"})
    text = write_report([tmp_path], tmp_path / "report.html").read_text()
    figures = re.search(r'id="figures">(.*?)</script>', text, re.S)[1]
    shown = json.dumps(json.loads(figures), ensure_ascii=False)
    assert not re.search(r"<(b|i|a)\b", shown)
    assert "&lt;b&gt;corridor" in shown and "&#37;{x}office" in shown


def test_outcome_of_a_recording_is_escaped(lost):
    if shutil.which("node") is None:
        pytest.skip("needs node")
    episode = episode_data("a", dataclasses.replace(lost, outcome=MARKUP))
    assert MARKUP in episode["ending"]
    place = page_module.__file__.replace("page.py", "drawing.js")
    with open(place) as file:
        script = file.read()
    code = (
        "const place = {}; const document = { getElementById: () => place };\n"
        f"{script}\ndrawLegend({json.dumps(episode)}); console.log(place.innerHTML);"
    )
    done = subprocess.run(["node", "-e", code], capture_output=True, text=True, check=True)
    assert "<img" not in done.stdout and "&lt;img" in done.stdout


def test_legend_is_escaped():
    """As above without a JavaScript engine: the only text of a file passes ``literal``."""
    place = page_module.__file__.replace("page.py", "drawing.js")
    with open(place) as file:
        script = file.read()
    assert "</svg>${literal(text)}</span>" in script
    for name in ("page.js", "player.js"):
        with open(place.replace("drawing.js", name)) as file:
            assert "innerHTML" not in file.read()


def test_embedded_data_cannot_close_the_script():
    text = page_module._embedded({"a": "</script><!--<script>&"})
    assert not set("<>&") & set(text)
    assert json.loads(text) == {"a": "</script><!--<script>&"}


def test_formulas_in_names_are_text_in_spreadsheets(tmp_path):
    write_evaluation(tmp_path / "a", "=1+1", [WON, HIT], time_to_goal_s="{time}")
    tables = compare(find_evaluations([tmp_path]))
    for text in (comma_separated(tables), metrics_comma_separated(tables)):
        assert ",'=1+1," in text and ",=1+1" not in text
    assert ",0.5," in comma_separated(tables)


def test_dollars_in_names_are_literal(tmp_path):
    folder = tmp_path / r"a$\no_such_command{$b"
    write_text(folder / "metrics.csv", "frames,evaluation/success_rate\n1,0.5\n2,0.6\n")
    (file,) = plot_curves([folder / "metrics.csv"], tmp_path / "curves", formats=[".svg"])
    assert r"a$\no_such_command{$b" in html.unescape(file.read_text())
