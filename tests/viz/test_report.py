"""The report: one page that needs nothing else, opened in a real browser where there is one."""

import csv
import dataclasses
import json
import re
import sys

import numpy as np
import pytest
from browser import Chromium, find_chromium
from evaluated import HIT, LATE, WON, write_evaluation

from navrl.cli.report import main
from navrl.evaluation.comparison import compare
from navrl.evaluation.statistics import wilson_interval
from navrl.evaluation.stored import find_evaluations
from navrl.viz.report import write_report
from navrl.viz.report.sources import find_sources

pytest.importorskip("plotly", reason="needs pip install 'navrl[report]'")


@pytest.fixture(scope="module")
def lost(recording):
    """The recorded episode as one that was lost, by a policy that hides a tag in its name."""
    steps = recording.num_steps
    reward = {"progress": np.linspace(0, 1, steps, dtype=np.float32)}
    return dataclasses.replace(recording, outcome="collision_static", reward_terms=reward)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, recording, lost):
    folder = tmp_path_factory.mktemp("sweep")
    for name, policy, outcomes in (
        ("a", "paper", [WON] * 11 + [HIT]),
        ("b", "dwa", [HIT] * 8 + [WON] * 2 + [LATE] * 2),
        ("c", "</script><b>evil</b>", [WON] * 10 + [HIT] * 2),
        ("d", "oracle", [WON] * 12),
        ("e", "mine_seed_0", [HIT] * 12),
        ("f", "mine_seed_1", [HIT] * 11 + [WON]),
    ):
        spl = {"unit": "1", "better": "higher", "all": {"mean": 0.5, "interval": [0.25, 0.75]}}
        measures = {} if policy == "oracle" else {"metrics": {"spl": spl}}
        write_evaluation(folder / name, policy, outcomes, **measures)
    with (folder / "metrics.csv").open("w", newline="") as file:
        rows = [["frames", "evaluation/success_rate"], [100, 0.25], [200, 0.5]]
        csv.writer(file).writerows(rows)
    (folder / "played").mkdir()
    dataclasses.replace(recording, outcome="success").save(folder / "played" / "won.npz")
    lost.save(folder / "played" / "lost.npz")
    return folder


@pytest.fixture(scope="module")
def page(folder):
    return write_report([folder], folder / "deep" / "report.html")


def embedded(page, name):
    pattern = rf'<script type="application/json" id="{name}">(.*?)</script>'
    return json.loads(re.search(pattern, page.read_text(), re.S)[1])


def test_the_page_says_who_is_better_and_by_how_much(page):
    text = page.read_text()
    assert "paper succeeds in 91.7 % [64.6, 98.5] of 12 episodes" in text
    assert "8.3 points more than the next" in text
    assert re.search(r"may be chance \(p ≥ 0.05\)[^<]*oracle", text)
    assert "dwa" not in re.search(r"may be chance[^<]*", text)[0]
    assert '<th scope="row">oracle*</th>' in text
    assert '<th scope="row">mine</th><td data-value="2">2</td>' in text
    measured = re.search(r'<th scope="row">spl</th>.*?</tr>', text)[0]
    assert measured.count("0.5 <small>[0.25, 0.75]</small>") == 5
    assert measured.count('data-value=""') == 1  # the oracle's file has no measures


def test_the_page_needs_nothing_else_and_names_end_no_element(page):
    from plotly.offline import get_plotlyjs

    text = page.read_text().replace(get_plotlyjs(), "")
    assert len(text) < 3e6
    assert not re.search(r'(src|href)="(https?:)?//', text)
    assert "<b>evil" not in text
    assert any("evil" in str(f) for f in embedded(page, "figures").values())


def test_episodes_are_what_was_recorded(page, lost):
    first, second = embedded(page, "episodes")
    assert "collision with a wall" in first["name"] and "goal reached" in second["name"]
    assert np.allclose(first["pose"], lost.pose, atol=1e-4)
    assert np.allclose(first["action"], lost.action, atol=1e-4)
    assert np.allclose(first["points"], lost.points, atol=1e-3)
    assert np.allclose(first["spatial"]["weights"], lost.spatial_attention, atol=1e-5)
    real = lost.tagd_valid.all(axis=-1)
    assert [step["valid"] for step in first["tagd"]] == real.astype(int).tolist()
    seconds = lost.num_steps * lost.time_step_s
    assert first["story"].startswith(f"Collision with a wall after {seconds:.1f} s.")


def test_a_limit_keeps_lost_episodes_and_says_so(folder, tmp_path):
    file = write_report([folder], tmp_path / "short.html", num_episodes=1)
    (only,) = embedded(file, "episodes")
    assert only["outcome"] == "collision_static"
    assert "1 of 2 recorded episodes" in file.read_text()


def test_policies_take_turns_and_give_their_episodes_their_names(tmp_path, lost):
    for policy, count in (("dwa", 5), ("paper", 2)):
        recordings = tmp_path / policy / "recordings"
        recordings.mkdir(parents=True)
        for index in range(count):
            lost.save(recordings / f"{index:06d}.npz")
    dataclasses.replace(lost, outcome="success").save(tmp_path / "dwa/recordings/000009.npz")
    names = [name for name, _ in find_sources([tmp_path], num_episodes=6).recordings]
    assert names == [
        *("dwa/000000", "paper/000000", "dwa/000001"),
        *("paper/000001", "dwa/000002", "dwa/000003"),
    ]


def write_sweep(folder, policy, wins):
    """Suites of one world each, as the frozen sweeps have them: of 10 episodes so many are won."""
    for (world, speed), won in wins.items():
        suite = f"speed_{world}_{speed}"
        outcomes = [WON] * won + [HIT] * (10 - won)
        part = {"episodes": 10, "success_rate": won / 10}
        place = folder / suite / policy
        write_evaluation(place, policy, outcomes, suite=suite, by_scenario={world: part})


def test_success_over_speed_is_shown_for_each_world_and_for_all(tmp_path):
    from navrl.viz.report.charts import rates_chart

    wins = {("corridor", 0.2): 9, ("corridor", 1.0): 7, ("office", 0.2): 5, ("office", 1.0): 2}
    write_sweep(tmp_path, "paper", wins)
    write_sweep(tmp_path, "dwa", {("corridor", 0.2): 4, ("corridor", 1.0): 3, ("office", 1.0): 1})
    figure = rates_chart(find_evaluations([tmp_path]))
    titles = {note.x: note.text for note in figure.layout.annotations}
    assert [titles[x] for x in sorted(titles)] == ["corridor", "office", "all worlds"]
    drawn = [(t.name, t.xaxis, list(zip(t.x, t.y, strict=True))) for t in figure.data]
    assert drawn == [
        ("paper", "x", [(0.2, 0.9), (1.0, 0.7)]),
        ("dwa", "x", [(0.2, 0.4), (1.0, 0.3)]),
        ("paper", "x2", [(0.2, 0.5), (1.0, 0.2)]),
        ("dwa", "x2", [(1.0, 0.1)]),
        ("paper", "x3", [(0.2, 0.7), (1.0, 0.45)]),
        ("dwa", "x3", [(1.0, 0.2)]),
    ]
    assert [t.name for t in figure.data if t.showlegend] == ["paper", "dwa"]
    assert figure.data[4].error_y.array[0] == pytest.approx(wilson_interval(14, 20)[1] - 0.7)
    assert figure.layout.xaxis3.title.text.startswith("pedestrian speed in m/s")


def test_fourteen_names_look_different(tmp_path):
    from navrl.viz.report import charts

    for i in range(14):
        folder = tmp_path / f"policy_{i}"
        part = {"episodes": 10, "success_rate": 0.5, "success_interval": [0.2, 0.8]}
        worlds = {"corridor": part, "office": part}
        for speed in (0.2, 1.0):
            suite = f"speed_{speed}"
            outcomes = [WON] * 5 + [HIT] * 5
            write_evaluation(folder / suite, folder.name, outcomes, suite=suite, by_scenario=worlds)
        (folder / "metrics.csv").write_text("frames,evaluation/success_rate\n100,0.5\n")
    evaluations = find_evaluations([tmp_path])
    lines = [
        charts.rates_chart(evaluations).data[:14],
        charts.curves_chart([e.folder.parent / "metrics.csv" for e in evaluations[::2]]).data,
    ]
    for traces in lines:
        assert len({(t.line.color, t.line.dash) for t in traces}) == 14
        assert len({(t.line.color, t.marker.symbol) for t in traces}) == 14
    table, *_ = compare(evaluations)
    bars = charts.world_chart(table, evaluations).data
    assert len({(t.marker.color, t.marker.pattern.shape) for t in bars}) == 14


def test_mistakes_are_one_line(tmp_path, capsys):
    for arguments, words in (
        ([str(tmp_path / "nowhere")], "no such folder"),
        ([str(tmp_path)], "no evaluation, no training and no recorded episode"),
        ([str(tmp_path), "--out", "page.pdf"], "must end in .html"),
        ([str(tmp_path), "--episodes", "-1"], "num_episodes=-1"),
    ):
        with pytest.raises(SystemExit) as exit_:
            main(arguments)
        (line,) = capsys.readouterr().err.splitlines()
        assert exit_.value.code == 2
        assert line.startswith("navrl: ") and words in line


def test_without_plotly_it_says_what_to_install(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(ImportError, match=r"navrl\[report\]"):
        write_report([folder], tmp_path / "report.html")


# --- in a browser --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    if find_chromium() is None:
        pytest.skip("no chromium here: apt-get install chromium")
    browser = Chromium(tmp_path_factory.mktemp("profile"))
    browser.open(page.as_uri())
    yield browser
    browser.close()


def to_step(browser, step):
    """Move the slider as a hand would: its value, then the event."""
    browser.evaluate(
        f"(() => {{ const t = document.getElementById('time'); t.value = {step};"
        "t.dispatchEvent(new Event('input', {bubbles: true})); })()"
    )
    browser.wait(f"document.getElementById('clock').textContent.includes('step {step} of')")


def scene(browser, name):
    data = f"document.getElementById('scene').data.find((t) => t.name === {name!r})"
    return browser.evaluate(f"(() => {{ const t = {data}; return t && [t.x, t.y]; }})()")


def test_the_slider_moves_the_robot_and_what_it_saw(browser, lost):
    for step in (0, 7, lost.num_steps):
        to_step(browser, step)
        x, y = scene(browser, "robot's way")
        assert len(x) == step + 1
        assert [x[-1], y[-1]] == pytest.approx(lost.pose[step, :2].tolist(), abs=1e-4)
        hits = (np.linalg.norm(lost.points[step], axis=-1) < lost.max_range - 1e-3).sum()
        assert len(scene(browser, "scan")[0]) == hits
        cursor = browser.evaluate("document.getElementById('commands').layout.shapes[0].x0")
        assert cursor == pytest.approx(step * lost.time_step_s)
    assert browser.errors == []


def test_attention_follows_the_step(browser, lost):
    to_step(browser, 5)
    for name in ("spatial", "temporal"):
        weights = browser.evaluate(f"document.getElementById('{name}').data[0].y")
        assert weights == pytest.approx(getattr(lost, f"{name}_attention")[5].tolist(), abs=1e-5)
    count = "document.getElementById('scene').layout.shapes.length"
    with_all = browser.evaluate(count)
    browser.evaluate("document.querySelector('.layer[value=spatial]').click()")
    sectors = lost.spatial_attention.shape[1]
    assert browser.evaluate(count) == with_all - sectors
    browser.evaluate("document.querySelector('.layer[value=spatial]').click()")
    assert browser.evaluate(count) == with_all
    browser.evaluate("document.querySelector('.layer[value=descriptors]').click()")
    assert scene(browser, "TAGD, t-1 to t") is None
    browser.evaluate("document.querySelector('.layer[value=descriptors]').click()")
    assert browser.errors == []


def test_commands_and_rewards_are_drawn_over_time(browser, lost):
    v, w = browser.evaluate("document.getElementById('commands').data.map((t) => t.y)")
    assert v[:-1] == pytest.approx(lost.action[:, 0].tolist(), abs=1e-4)
    assert w[:-1] == pytest.approx(lost.action[:, 1].tolist(), abs=1e-4)
    (name,) = browser.evaluate("document.getElementById('rewards').data.map((t) => t.name)")
    assert name == "progress"


def test_another_episode_and_play(browser, lost):
    browser.evaluate(
        "(() => { const e = document.getElementById('episode'); e.value = 1;"
        "e.dispatchEvent(new Event('change')); })()"
    )
    browser.wait("document.getElementById('story').textContent.startsWith('Goal reached')")
    to_step(browser, 0)
    browser.evaluate("document.getElementById('play').click()")
    browser.wait("document.getElementById('time').value >= 2")
    assert browser.evaluate("document.getElementById('play').textContent") == "Pause"
    browser.evaluate("document.getElementById('play').click()")
    browser.evaluate(
        "(() => { const e = document.getElementById('episode'); e.value = 0;"
        "e.dispatchEvent(new Event('change')); })()"
    )
    browser.wait("document.getElementById('story').textContent.startsWith('Collision')")
    assert browser.errors == []


def test_tables_sort_by_a_click(browser):
    def order(column):
        return browser.evaluate(
            "(() => { const table = document.querySelector('table.sortable');"
            f"table.tHead.rows[0].cells[{column}].querySelector('button').click();"
            "return [...table.tBodies[0].rows].map((row) => row.cells[0].textContent); })()"
        )

    assert order(2) == [
        *("mine_seed_0", "mine_seed_1", "dwa"),
        *("</script><b>evil</b>", "paper", "oracle*"),
    ]  # success, least first
    assert order(2)[0] == "oracle*"
    by_difference = order(7)
    assert by_difference[0] == "mine_seed_0" and by_difference[-1] == "paper"  # which has none
    assert order(7)[-1] == "paper"
    assert browser.errors == []


def test_figures_show_numbers_where_the_mouse_is(browser):
    drawn = browser.evaluate(
        "[...document.querySelectorAll('figure .plot')].map((p) => p.data.length)"
    )
    assert len(drawn) >= 4 and all(drawn)
    place = "document.querySelector('figure .plot')"
    browser.evaluate(f"Plotly.Fx.hover({place}, [{{curveNumber: 0, pointNumber: 0}}])")
    text = browser.evaluate(f"{place}.querySelector('.hoverlayer').textContent")
    assert "mine_seed_0: 0.0% of 12" in text
    assert browser.errors == []
