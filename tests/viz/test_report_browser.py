"""The report in a real browser, where there is one."""

import dataclasses
import time

import numpy as np
import pytest
from evaluated import HIT, WON, write_evaluation

from navrl.sim import Contact
from navrl.viz.report import write_report

pytest.importorskip("plotly", reason="needs the extra report")


@pytest.fixture(scope="module")
def browser(page, chromium):
    chromium.open(page.as_uri())
    return chromium


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


def test_slider_moves_the_robot_and_the_scan(browser, lost):
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
    browser.wait("document.getElementById('story').textContent.startsWith('The robot reached')")
    to_step(browser, 0)
    browser.evaluate("document.getElementById('play').click()")
    browser.wait("document.getElementById('time').value >= 2")
    assert browser.evaluate("document.getElementById('play').textContent") == "Pause"
    browser.evaluate("document.getElementById('play').click()")
    browser.evaluate(
        "(() => { const e = document.getElementById('episode'); e.value = 0;"
        "e.dispatchEvent(new Event('change')); })()"
    )
    browser.wait("document.getElementById('story').textContent.startsWith('The robot hit')")
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


def test_figures_show_numbers_on_hover(browser):
    drawn = browser.evaluate(
        "[...document.querySelectorAll('figure .plot')].map((p) => p.data.length)"
    )
    assert len(drawn) >= 4 and all(drawn)
    place = "document.querySelector('figure .plot')"
    browser.evaluate(f"Plotly.Fx.hover({place}, [{{curveNumber: 0, pointNumber: 0}}])")
    text = browser.evaluate(f"{place}.querySelector('.hoverlayer').textContent")
    assert "mine_seed_0: 0.0% of 12" in text
    assert browser.errors == []


# --- of two evaluations that kept their episodes -------------------------------------------------


@pytest.fixture
def two(tmp_path, chromium, recording, lost):
    """A page open in the browser: paper won one of two, dwa was run into and hit a wall."""
    hit = dataclasses.replace(lost, outcome=HIT, contact=Contact.HIT_BY_PEDESTRIAN)
    won = dataclasses.replace(lost, outcome=WON, contact=Contact.NONE)
    for policy, episodes in (("paper", (hit, won)), ("dwa", (hit, lost))):
        outcomes = [episode.outcome for episode in episodes]
        write_evaluation(tmp_path / policy, policy, outcomes, time_to_goal_s="{time}")
        (tmp_path / policy / "recordings").mkdir()
        for index, episode in enumerate(episodes):
            episode.save(tmp_path / policy / "recordings" / f"{index:06d}.npz")
    chromium.open(write_report([tmp_path], tmp_path / "two.html").as_uri())
    yield chromium
    assert chromium.errors == []


def text_of(browser, selector):
    return browser.evaluate(f"document.querySelector({selector!r}).textContent")


@pytest.mark.slow
def test_page_of_two_evaluations_describes_the_test(two):
    verdict = text_of(two, ".verdict")
    assert verdict.startswith("paper succeeds in 50.0 % [9.5, 90.5] of 2 episodes. On the same 2")
    assert (
        "more than the next approach, dwa. There is no test with fewer than 6 episodes." in verdict
    )
    header = "[...document.querySelector('.measures thead tr').cells].map((c) => c.textContent)"
    assert two.evaluate(header) == [
        *("measure", "better", "policy", "mean", "n"),
        *("mean over 1 episodes where all succeed", "n of these"),
        *("difference to paper", "pairs", "p"),
    ]


def test_a_click_on_an_episode_opens_it_in_the_player(two):
    rows = two.evaluate(
        "[...document.querySelectorAll('tr.opens')].map("
        "(row) => [...row.cells].map((cell) => cell.textContent))"
    )
    told = [(index, policy) for index, policy, *_ in rows]
    assert sorted(told) == [("0", "dwa"), ("0", "paper"), ("1", "dwa"), ("1", "paper")]
    for index, policy in (("1", "dwa"), ("1", "paper"), ("0", "dwa")):
        row = told.index((index, policy))
        two.evaluate(f"document.querySelectorAll('tr.opens')[{row}].cells[2].click()")
        chosen = "document.getElementById('episode').selectedOptions[0].textContent"
        two.wait(f"{chosen}.startsWith('{policy}/00000{index}')")
        assert two.evaluate("state.episode === Number(document.getElementById('episode').value)")
    assert text_of(two, "#story").startswith("A pedestrian moved into the robot after ")
    click_on_heatmap(two, across=0.75, down=0.25)  # paper's second episode
    two.wait("document.getElementById('story').textContent.startsWith('The robot reached')")


def click_on_heatmap(browser, across, down):
    """Click with the mouse at these shares of the axes of "Each episode"."""
    left, top, width, height = browser.evaluate(
        "(() => { const plots = [...document.querySelectorAll('figure .plot')];"
        "const place = plots.find((plot) => plot.data[0].type === 'heatmap');"
        "place.scrollIntoView();"
        "const box = place.querySelector('.nsewdrag').getBoundingClientRect();"
        "return [box.x, box.y, box.width, box.height]; })()"
    )
    at = {"x": left + across * width, "y": top + down * height}
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", **at)
    time.sleep(0.2)  # plotly looks for what is below the mouse every 50 ms
    for kind in ("mousePressed", "mouseReleased"):
        browser.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **at)


@pytest.mark.slow
def test_legend_names_drawn_objects_and_end_is_marked(two, lost):
    two.wait("document.getElementById('story').textContent.startsWith('A pedestrian moved')")
    legend = text_of(two, "#legend")
    for name in ("robot", "goal", "global path", "pedestrian", "scan", "TAGD"):
        assert name in legend
    full = np.median(lost.spatial_attention.max(axis=1))
    assert f"Spatial attention, sectors: low, 0  high, ≥ {full:.2f}" in legend
    assert "Temporal attention" in legend
    assert "the end: pedestrian moved into the robot" in legend
    assert two.evaluate("document.querySelectorAll('#legend .scale i').length") == 2
    to_step(two, lost.num_steps)
    ring = two.evaluate("document.getElementById('scene').layout.shapes.at(-1)")
    two.wait("document.querySelectorAll('#scene .shapelayer .shape-group').length === 3")
    middle = [(ring["x0"] + ring["x1"]) / 2, (ring["y0"] + ring["y1"]) / 2]
    assert middle == pytest.approx(lost.pose[-1, :2].tolist(), abs=1e-4)
    assert ring["line"] == {"color": "#E8000B", "width": 4}


def test_a_folded_suite_is_drawn_when_it_is_opened(tmp_path, chromium):
    for i in range(4):
        write_evaluation(tmp_path / str(i), "paper", [WON, HIT], suite=f"speed_{i}")
    chromium.open(write_report([tmp_path], tmp_path / "many.html").as_uri())
    drawn = "[...document.querySelectorAll('.evaluation > details .plot')].map((p) => !!p.data)"
    assert not any(chromium.evaluate(drawn))
    chromium.evaluate("document.querySelector('.evaluation > details > summary').click()")
    chromium.wait(f"{drawn}.every((is) => is)")
    width = "document.querySelector('.evaluation > details .plot .main-svg').clientWidth"
    assert chromium.evaluate(width) > 1000
    assert chromium.errors == []
