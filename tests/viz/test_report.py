"""The report: one page that needs nothing else; test_report_browser.py opens it."""

import csv
import dataclasses
import html
import json
import re
import sys

import numpy as np
import pytest
from evaluated import HIT, LATE, WON, write_evaluation

from navrl.cli.report import main
from navrl.evaluation.comparison import compare
from navrl.evaluation.statistics import wilson_interval
from navrl.evaluation.stored import find_evaluations
from navrl.sim import Contact
from navrl.viz.report import write_report
from navrl.viz.report.episodes import episode_data
from navrl.viz.report.sources import find_sources

pytest.importorskip("plotly", reason="needs the extra report")


def embedded(page, name):
    pattern = rf'<script type="application/json" id="{name}">(.*?)</script>'
    return json.loads(re.search(pattern, page.read_text(), re.S)[1])


def test_page_states_the_best_policy_and_difference(page):
    text = page.read_text()
    assert "paper succeeds in 91.7 % [64.6, 98.5] of 12 episodes" in text
    next_best = (
        r"On the same 12 episodes these are 8.3 points more than the next approach, [^<]*evil"
    )
    assert re.search(next_best + r"[^<]*p = 1.000\), which is not significant", text)
    assert re.search(r"not significant \(p ≥ 0.05\)[^<]*oracle", text)
    assert "dwa" not in re.search(r"not significant[^<]*", text)[0]
    assert '<th scope="row">oracle*</th>' in text
    assert '<th scope="row">mine</th><td data-value="2">2</td>' in text


def cells(page, name, policy):
    """The cells of a measure's row in the table of measures, as a reader sees them."""
    row = next(
        row
        for row in re.findall(rf'<tr><th scope="row">{name}</th>.*?</tr>', page.read_text())
        if f'<td class="words">{policy}</td>' in row
    )
    return [re.sub(r"<[^>]+>", "", cell) for cell in re.findall(r"<td.*?</td>", row)]


def test_measures_are_over_successes_and_paired(tmp_path):
    for name, policy, outcomes, delay in (
        ("a", "paper", [WON, WON, WON, WON, HIT], 0.0),
        ("b", "dwa", [HIT, WON, WON, LATE, "error"], 2.0),
    ):
        write_evaluation(tmp_path / name, policy, outcomes, time_to_goal_s="{time}", delay=delay)
    page = write_report([tmp_path], tmp_path / "report.html")
    lower, policy, mean, n, common, of_these, difference, pairs, _ = cells(
        page, "path_length_m", "dwa"
    )
    assert (lower, policy) == ("lower", "dwa")
    assert mean.startswith("13.5") and n == "2 successes"  # all five would have 14
    assert common.startswith("13.5") and of_these == "2"
    assert difference == "+2" and pairs == "2"
    own = cells(page, "path_length_m", "paper")
    assert own[2].startswith("11.5") and own[3] == "4 successes"
    assert own[4].startswith("11.5") and own[5] == "2"
    assert own[6:] == ["\N{EN DASH}"] * 3
    assert "All measures; episodes that raised an error: dwa 1</summary>" in page.read_text()
    assert "mean over 2 episodes where all succeed" in page.read_text()


def test_latencies_are_listed_among_the_measures(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON, HIT])
    latency = {"calls": 40, "mean_ms": 1.5, "median_ms": 1.4, "p95_ms": 2.2, "max_ms": 3.0}
    (tmp_path / "a" / "latency.json").write_text(json.dumps(latency))
    page = write_report([tmp_path], tmp_path / "report.html")
    found = cells(page, "latency_p95_ms", "paper")
    assert found[:4] == ["lower", "paper", "2.2", "40 decisions"]


def test_default_reference_is_the_best_non_privileged(tmp_path):
    for policy, wins in (("dwa", 2), ("liang", 9), ("oracle", 12), ("subgoal", 3)):
        write_evaluation(tmp_path / policy, policy, [WON] * wins + [HIT] * (12 - wins))
    text = write_report([tmp_path], tmp_path / "report.html").read_text()
    assert "liang succeeds in 75.0 %" in text
    assert "50.0 points more than the next approach, subgoal" in text
    assert "p = 0.031), which is significant" in text
    assert "Differences are to liang." in text
    assert "success vs liang, points" in text
    text = write_report([tmp_path], tmp_path / "report.html", reference="dwa").read_text()
    assert "success vs dwa, points" in text and "Differences are to dwa." in text


def test_collisions_are_labeled_by_party_and_object(tmp_path):
    folder = tmp_path / "paper"
    write_evaluation(folder, "paper", [WON] + [HIT] * 3 + ["collision_static"] * 3 + [LATE])
    names = ("hit_by_pedestrian", "moved_into_pedestrian", "collision_wall", "collision_furniture")
    told = {1: "hit_by_pedestrian", 2: "moved_into_pedestrian", 4: "collision_wall"}
    told[5] = "collision_furniture"
    with (folder / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    for index, row in enumerate(rows):
        row |= {name: str(int(told.get(index) == name)) for name in names}
    for index in (3, 6):  # as evaluations before these columns have them
        rows[index] |= dict.fromkeys(names, "")
    with (folder / "episodes.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    figures = embedded(write_report([tmp_path], tmp_path / "report.html"), "figures")
    bars = {t["name"]: t for t in figures["figure-1"]["data"]}
    assert {name: bar["customdata"] for name, bar in bars.items()} == {
        "success": [1],
        "robot moved into a pedestrian": [1],
        "pedestrian moved into the robot": [1],
        "collision with a pedestrian, fault unknown": [1],
        "collision with a wall": [1],
        "collision with furniture": [1],
        "collision with a wall or furniture": [1],
        "timeout": [1],
    }
    assert len({bar["marker"]["color"] for bar in bars.values()}) == len(bars)


def test_page_without_recordings_states_how_to_create_them(tmp_path):
    folder = tmp_path / "speed=0.2,0.2" / "paper"
    write_evaluation(folder, "paper", [WON, HIT])
    write_evaluation(tmp_path / "dwa", "dwa", [WON, HIT])
    text = html.unescape(write_report([tmp_path], tmp_path / "report.html").read_text())
    assert (
        f"navrl-evaluate --config-dir {folder} --config-name config recordings=failures "
        f"'hydra.run.dir=\"{folder}_recorded\"'\n"
        f"navrl-report {tmp_path} {folder}_recorded<"
    ) in text


def test_repeated_recordings_count_once(tmp_path, lost):
    write_evaluation(tmp_path / "paper", "paper", [HIT, WON])
    write_evaluation(tmp_path / "paper_recorded", "paper", [HIT, WON])
    (tmp_path / "paper_recorded" / "recordings").mkdir()
    lost.save(tmp_path / "paper_recorded" / "recordings" / "000000.npz")
    sources = find_sources([tmp_path], num_episodes=3)
    (evaluation,) = sources.evaluations
    assert evaluation.folder.name == "paper_recorded"
    assert sources.places() == [(evaluation, 0)]
    write_evaluation(tmp_path / "other", "paper", [WON, WON])
    assert len(find_sources([tmp_path], num_episodes=3).evaluations) == 2


def test_only_three_suites_are_initially_expanded(tmp_path):
    for i in range(5):
        outcomes = [WON] * (i + 1) + [HIT] * (5 - i)
        write_evaluation(tmp_path / str(i), "paper", outcomes, suite=f"speed_{i}")
    text = write_report([tmp_path], tmp_path / "report.html").read_text()
    folded = re.findall(r"<summary><h2 id=.*?>(speed_\d).*?</h2><p>(.*?)</p></summary>", text)
    assert folded == [
        ("speed_3", "paper succeeds in 66.7 % [30.0, 90.3] of 6 episodes."),
        ("speed_4", "paper succeeds in 83.3 % [43.6, 97.0] of 6 episodes."),
    ]


def test_page_is_self_contained_and_escaped(page):
    from plotly.offline import get_plotlyjs

    text = page.read_text().replace(get_plotlyjs(), "")
    assert len(text) < 3e6
    assert not re.search(r'(src|href)="(https?:)?//', text)
    assert "<b>evil" not in text
    assert any("evil" in str(f) for f in embedded(page, "figures").values())


def test_episodes_equal_the_recordings(page, lost):
    first, second = embedded(page, "episodes")
    assert "collision with a wall" in first["name"] and "success" in second["name"]
    assert np.allclose(first["pose"], lost.pose, atol=1e-4)
    assert np.allclose(first["action"], lost.action, atol=1e-4)
    assert np.allclose(first["points"], lost.points, atol=1e-3)
    assert np.allclose(first["spatial"]["weights"], lost.spatial_attention, atol=1e-5)
    real = lost.tagd_valid.all(axis=-1)
    assert [step["valid"] for step in first["tagd"]] == real.astype(int).tolist()
    seconds = lost.num_steps * lost.time_step_s
    assert first["story"].startswith(f"The robot hit a wall after {seconds:.1f} s; contact was ")


def test_description_names_the_at_fault_party(recording):
    x, y, yaw = recording.pose[-1]
    pedestrian = np.full_like(recording.pedestrian_boxes, np.nan)
    at = yaw + np.radians(40)
    pedestrian[-1, 0] = x + 0.3 * np.cos(at), y + 0.3 * np.sin(at), 1e-3, 1e-3, 0.0
    hit = dataclasses.replace(recording, outcome=HIT, pedestrian_boxes=pedestrian)

    def told(row=None, **changes):
        return episode_data("played", dataclasses.replace(hit, **changes), row)["story"]

    assert told(contact=Contact.PEDESTRIAN).startswith("The robot moved into a pedestrian after ")
    assert told(contact=Contact.HIT_BY_PEDESTRIAN).startswith(
        "A pedestrian moved into the robot after "
    )
    assert "; contact was 40° to the left of the robot's heading." in told(
        contact=Contact.HIT_BY_PEDESTRIAN
    )
    assert "the at-fault party was not recorded" in told(contact=None)
    row = {"outcome": HIT, "hit_by_pedestrian": "1", "moved_into_pedestrian": "0"}
    assert told(row, contact=None).startswith("A pedestrian moved into the robot after ")
    scenario = json.loads(recording.scenario)
    static = {"outcome": "collision_static", "contact": Contact.STATIC}
    assert told(**static).startswith("The robot hit a wall after ")
    furnished = json.dumps(scenario | {"num_furniture": len(scenario["boxes"])})
    told_furniture = told(**static, scenario=furnished)
    assert told_furniture.startswith("The robot hit a piece of furniture after ")
    assert told(outcome="timeout", contact=0).startswith("The time limit was reached after ")


def test_episode_limit_keeps_failures_and_is_stated(folder, tmp_path):
    file = write_report([folder], tmp_path / "short.html", num_episodes=1)
    (only,) = embedded(file, "episodes")
    assert only["outcome"] == "collision_static"
    assert "1 of 2 recorded episodes" in file.read_text()


def test_episodes_alternate_between_policies(tmp_path, lost):
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


def test_fourteen_policies_have_distinct_styles(tmp_path):
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


def test_errors_are_one_line(tmp_path, capsys):
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


def test_missing_plotly_is_named(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(ImportError, match=r"-e '\.\[report\]"):
        write_report([folder], tmp_path / "report.html")
