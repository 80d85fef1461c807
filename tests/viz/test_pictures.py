"""The pictures of ``navrl-plot``: right numbers from files, errors that name the source."""

import csv
import dataclasses
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch
import yaml
from evaluated import HIT, LATE, WON, write_evaluation
from PIL import Image

from navrl.config import CONF_DIR
from navrl.evaluation.statistics import wilson_interval
from navrl.evaluation.stored import find_evaluations
from navrl.ops import grouping
from navrl.viz import (
    pictures,
    plot_rates,
    plot_robustness,
    rates,
    robustness,
    save_failures,
    save_mp4,
    save_tagd,
    tagd,
)

WORLDS = ("corridor", "office")


def write_point(folder, policy, rate, speed=0.6, count=2, episodes=100, **changes):
    """An evaluation at one speed and number of pedestrians, alike in all worlds."""
    folder.mkdir(parents=True)
    part = {
        "episodes": episodes,
        "success_rate": rate,
        "collision_rate": 1.0 - rate,
        "timeout_rate": 0.0,
        "success_interval": wilson_interval(round(rate * episodes), episodes),
    }
    summary = {
        "policy": policy,
        "suite": "table1",
        "suite_hash": f"{speed} {count}",
        "simulator": "BatchedSimulator",
        **part,
        "by_scenario": dict.fromkeys(WORLDS, part),
        **changes,
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    lines = [f"{index},{WORLDS[index % 2]},timeout" for index in range(episodes)]
    (folder / "episodes.csv").write_text("\n".join(["index,scenario,outcome", *lines, ""]))
    distribution = {"num_dynamic": [count, count], "speed": [speed, speed]}
    config = {"suite": {"distribution": distribution}}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))


@pytest.fixture
def figures(monkeypatch):
    saved = []
    monkeypatch.setattr(rates, "save_figure", lambda figure, file: saved.append(figure) or file)
    return saved


def lines_of(axes):
    return {
        line.get_color(): list(zip(line.get_xdata(), line.get_ydata(), strict=True))
        for line in axes.lines
    }


def test_rates_over_speed_and_number(tmp_path, figures):
    for i, (speed, rate) in enumerate([(1.0, 0.5), (0.4, 0.9), (0.6, 0.8)]):
        write_point(tmp_path / f"s{i}", "paper", rate, speed=speed)
    write_point(tmp_path / "few", "paper", 0.1, speed=0.6, episodes=10)  # gives way to 100
    write_point(tmp_path / "n8", "paper", 0.3, count=8)
    write_point(tmp_path / "dwa", "dwa", 0.2, speed=0.4)
    write_point(tmp_path / "open", "paper", 0.99, speed=0.8, suite="open_space")
    plot_rates(find_evaluations([tmp_path]), tmp_path / "rates.png")
    (figure,) = figures
    assert [axes.get_title() for axes in figure.axes] == [*WORLDS, "all worlds"] * 2
    speed, number = lines_of(figure.axes[2]), lines_of(figure.axes[5])
    assert list(speed.values()) == [[(0.4, 0.9), (0.6, 0.8), (1.0, 0.5)], [(0.4, 0.2)]]
    assert list(number.values()) == [[(2.0, 0.8), (8.0, 0.3)]]
    assert "m/s" in figure.axes[0].get_xlabel()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["paper", "dwa"]


@pytest.mark.parametrize(
    ("name", "setting"), [("speed_0.8", (2, 0.8)), ("density_4", (4, 0.6)), ("table1", (2, 0.6))]
)
def test_suite_name_contains_its_setting(tmp_path, name, setting):
    write_point(tmp_path / "a", "paper", 0.5, suite=name)
    (tmp_path / "a" / "config.yaml").unlink()
    (evaluation,) = find_evaluations([tmp_path])
    point, *_ = rates.rate_points(evaluation)
    assert (point.num_dynamic, point.speed) == setting


def test_setting_is_read_from_episodes_first(tmp_path):
    write_point(tmp_path / "a", "paper", 0.5, suite="speed_v2", episodes=2)
    columns = "index,scenario,outcome,num_dynamic,pedestrian_speed_mps\n"
    (tmp_path / "a" / "episodes.csv").write_text(
        f"{columns}0,office,success,2,0.9\n1,office,timeout,2,0.9000001\n"
    )
    (evaluation,) = find_evaluations([tmp_path])
    point, *_ = rates.rate_points(evaluation)
    assert (point.num_dynamic, point.speed) == (2, 0.9)


def write_world(folder, world, rate, **point):
    """An evaluation of a suite of one world, as the frozen sweeps have them."""
    episodes = point.get("episodes", 100)
    part = {"episodes": episodes, "success_rate": rate}
    write_point(folder / f"{world}{point}", "paper", rate, by_scenario={world: part}, **point)


def test_separate_worlds_are_pooled_if_complete(tmp_path, figures):
    for world, won, episodes in (
        ("corridor", (0.9, 0.8, 0.7), 300),
        ("intersection", (0.8, 0.6, 0.4), 100),
        ("office", (0.5, 0.3), 100),  # not yet at 1.0 m/s
    ):
        for speed, rate in zip((0.2, 0.6, 1.0), won, strict=False):
            suite = f"speed_{world}_{speed}"
            point = {"suite": suite, "speed": speed, "episodes": episodes}
            write_world(tmp_path, world, rate, suite_hash=suite, **point)
    plot_rates(find_evaluations([tmp_path]), tmp_path / "rates.png")
    (figure,) = figures
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["corridor", "intersection", "office", "all worlds"]
    drawn = [next(iter(lines_of(axes).values())) for axes in figure.axes]
    assert drawn[0] == [(0.2, 0.9), (0.6, 0.8), (1.0, 0.7)]
    assert drawn[1] == [(0.2, 0.8), (0.6, 0.6), (1.0, 0.4)]
    assert drawn[2] == [(0.2, 0.5), (0.6, 0.3)]
    assert drawn[3] == [(0.2, (270 + 80 + 50) / 500), (0.6, (240 + 60 + 30) / 500)]
    corners = figure.axes[3].collections[0].get_paths()[0].vertices.tolist()
    assert [0.2, pytest.approx(wilson_interval(400, 500)[0])] in corners
    assert "100 to 300 episodes" in figure.legends[0].get_title().get_text()


def test_rates_read_density_from_density_suites(tmp_path):
    for kept, rate in ((1, 0.9), (2, 0.7), (8, 0.2)):
        write_world(tmp_path, "office", rate, suite=f"density_office_{kept}", count=kept)
        (config,) = tmp_path.glob(f"*density_office_{kept}'*/config.yaml")
        distribution = {"num_dynamic": [8, 8], "keep_dynamic": kept, "speed": [0.6, 0.6]}
        config.write_text(yaml.safe_dump({"suite": {"distribution": distribution}}))
    for speed, rate in ((0.2, 0.8), (0.6, 0.6)):
        write_world(tmp_path, "office", rate, suite=f"speed_office_{speed}", speed=speed)
    write_world(tmp_path, "office", 0.1, suite="table1_200", episodes=200)
    points = [p for e in find_evaluations([tmp_path]) for p in rates.rate_points(e)]
    speed, number = rates.rate_rows(points).values()
    assert list(speed) == list(number) == [("paper", "office")]  # nothing to pool
    assert [(x, p.rate) for x, p in speed["paper", "office"]] == [(0.2, 0.8), (0.6, 0.6)]
    assert [(x, p.rate) for x, p in number["paper", "office"]] == [(1, 0.9), (2, 0.7), (8, 0.2)]


def test_nine_policies_have_distinct_styles(tmp_path, figures):
    for i in range(9):
        for speed in (0.2, 0.6):
            write_point(tmp_path / f"{i}_{speed}", f"policy_{i}", 0.9 - i / 10, speed=speed)
    plot_rates(find_evaluations([tmp_path]), tmp_path / "rates.png")
    lines = figures[0].axes[0].lines
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 9
    assert len({(line.get_color(), line.get_marker()) for line in lines}) == 9


def test_rates_need_two_settings_of_one_simulator(tmp_path):
    write_point(tmp_path / "a", "paper", 0.5)
    with pytest.raises(ValueError, match=r"two speeds.*\(2, 0\.6\)"):
        plot_rates(find_evaluations([tmp_path]), tmp_path / "rates.png")
    write_point(tmp_path / "b", "paper", 0.5, speed=1.0, simulator="BulletSimulator")
    with pytest.raises(ValueError, match="one simulator"):
        plot_rates(find_evaluations([tmp_path]), tmp_path / "rates.png")


def test_group_centers_are_those_of_the_descriptors():
    generator = np.random.default_rng(0)
    points = generator.uniform(-3, 3, (60, 2))
    points = points[np.linalg.norm(points, axis=-1) < 3.4].astype(np.float32)
    hit = torch.ones(len(points), dtype=torch.bool)
    expected = grouping.group_centers(torch.from_numpy(points), hit, 30, 3.5)
    assert np.allclose(tagd.group_centers(points, 30, 3.5), expected.numpy(), atol=1e-5)
    nothing = tagd.group_centers(points[:0], 8, 3.5)
    assert np.allclose(np.linalg.norm(nothing, axis=-1), 3.5)


def test_tagd_steps_show_recorded_data(tmp_path, recording):
    text = save_tagd(recording, tmp_path / "tagd.svg").read_text()
    for words in ("two scans", "aligned by ICP", "center on each ray", "groups", "centroids"):
        assert words in text
    stage = tagd._Stage(recording, 5, 0.25)
    centers = stage.centers
    near = np.linalg.norm(stage.now[:, None] - centers[None], axis=-1) <= 0.25
    for i in np.flatnonzero(recording.tagd_valid[5].all(axis=-1)):
        centroid = stage.now[near[:, i]].mean(axis=0)
        assert np.allclose(centroid, recording.tagd[5, i, 2:], atol=1e-4), i
    with pytest.raises(ValueError, match="step=0"):
        save_tagd(recording, tmp_path / "tagd.png", step=0)
    without = dataclasses.replace(recording, tagd=None, tagd_valid=None)
    with pytest.raises(ValueError, match="no TAGDs"):
        save_tagd(without, tmp_path / "tagd.png")


def test_failures_exclude_successes(tmp_path, recording):
    lost = dataclasses.replace(recording, outcome="collision_static")
    won = dataclasses.replace(recording, outcome="success")
    text = save_failures([won, lost, lost, lost], tmp_path / "lost.svg", limit=2).read_text()
    assert ">2 of 3 failed episodes<" in text
    assert text.count("collision with a wall") == 2
    assert ">1 failed episode<" in save_failures([lost, won], tmp_path / "lost.svg").read_text()
    with pytest.raises(ValueError, match="none of 1 failed"):
        save_failures([won], tmp_path / "lost.svg")
    with pytest.raises(ValueError, match="limit=0"):
        save_failures([lost], tmp_path / "lost.svg", limit=0)


def write_recorded(folder, policy, outcomes, recording):
    """An evaluation that kept its lost episodes."""
    write_evaluation(folder, policy, outcomes)
    (folder / "recordings").mkdir()
    for index, outcome in enumerate(outcomes):
        if outcome != WON:
            lost = dataclasses.replace(recording, outcome=outcome)
            lost.save(folder / "recordings" / f"{index:06d}.npz")


def test_failure_counts_are_read_from_evaluations(tmp_path, recording):
    write_recorded(tmp_path / "a", "paper", [WON] * 7 + [HIT] * 3, recording)
    write_recorded(tmp_path / "b", "dwa", [WON] * 8 + [LATE] * 2, recording)
    (file,) = pictures.failures([tmp_path], tmp_path / "lost", [".svg"])
    text = file.read_text()
    assert ">5 of 20 episodes failed<" in text
    assert text.count(">paper<") == 3 and text.count(">dwa<") == 2
    (file,) = pictures.failures([tmp_path / "a"], tmp_path / "lost", [".svg"], limit=2)
    assert ">3 of 10 episodes failed; 2 of them shown<" in file.read_text()
    one = tmp_path / "a" / "recordings" / "000008.npz"
    (file,) = pictures.failures([one], tmp_path / "lost", [".svg"])
    assert ">3 of 10 episodes failed; 1 of them shown<" in file.read_text()
    (tmp_path / "b" / "summary.json").unlink()  # unfinished: nobody knows
    (file,) = pictures.failures([tmp_path], tmp_path / "lost", [".svg"])
    assert ">5 failed episodes<" in file.read_text() and ">paper<" in file.read_text()


def test_strip_names_the_episode_and_policy(tmp_path, recording):
    write_recorded(tmp_path / "a", "paper", [WON, HIT], recording)
    (file,) = pictures.strip([tmp_path / "a"], tmp_path / "strip", [".svg"])
    assert ">paper<" in file.read_text()
    assert ">pictured #1, intersection: collision with a pedestrian<" in file.read_text()
    (tmp_path / "played" / ".hydra").mkdir(parents=True)
    recording.save(tmp_path / "played" / "episode.npz")
    (file,) = pictures.strip([tmp_path / "played"], tmp_path / "strip", [".svg"])
    assert ">pictured #1, intersection: " in file.read_text()
    for asked, name in (
        ({"policy": "outputs/train/mine/policy", "change": {}}, "mine"),
        ({"policy": "paper", "change": {"transforms": {"tagd": None}}}, "paper, changed"),
    ):
        (tmp_path / "played" / ".hydra" / "config.yaml").write_text(yaml.safe_dump(asked))
        (file,) = pictures.strip([tmp_path / "played"], tmp_path / "strip", [".svg"])
        assert f">{name}<" in file.read_text()


def test_mp4_has_one_frame_per_step(tmp_path, recording, monkeypatch):
    """A program in ffmpeg's place notes what it is asked and how many bytes it is sent."""
    fake = tmp_path / "bin" / "ffmpeg"
    fake.parent.mkdir()
    fake.write_text(
        f"#!{sys.executable}\nimport sys\nwith open(sys.argv[-1], 'w') as file:\n"
        "    file.write(' '.join(sys.argv[1:]) + ' ' + str(len(sys.stdin.buffer.read())))\n"
    )
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(fake.parent))
    noted = save_mp4(recording, tmp_path / "episode.mp4", fps=10).read_text().split()
    width, height = map(int, noted[noted.index("-s") + 1].split("x"))
    assert width % 2 == height % 2 == 0
    assert float(noted[noted.index("-r") + 1]) == 10
    assert int(noted[-1]) == (recording.num_steps + 1 + 15) * width * height * 3


def test_mp4_is_playable(tmp_path, recording):
    if shutil.which("ffprobe") is None:
        pytest.skip("needs the programs ffmpeg and ffprobe")
    file = save_mp4(recording, tmp_path / "episode.mp4", fps=10)
    asked = "stream=codec_name,nb_frames", "-of", "csv=p=0", str(file)
    probe = subprocess.check_output(["ffprobe", "-v", "error", "-show_entries", *asked], text=True)
    assert probe.strip() == f"h264,{recording.num_steps + 1 + 15}"


def test_mp4_error_states_its_cause(tmp_path, recording, monkeypatch):
    with pytest.raises(ValueError, match=r"\.mp4"):
        save_mp4(recording, tmp_path / "episode.gif")
    with pytest.raises(ValueError, match="fps=90"):
        save_mp4(recording, tmp_path / "episode.mp4", fps=90)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FileNotFoundError, match="apt install ffmpeg"):
        save_mp4(recording, tmp_path / "episode.mp4")
    fake = tmp_path / "ffmpeg"
    fake.write_text(f"#!{sys.executable}\nimport sys\nsys.exit('no encoder')\n")
    fake.chmod(0o755)
    with pytest.raises(RuntimeError, match="no encoder"):
        save_mp4(recording, tmp_path / "episode.mp4")


def write_log(folder, rate):
    folder.mkdir()
    with (folder / "metrics.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["frames", "evaluation/success_rate", "train/max_dynamic"])
        writer.writerows([[100 * i, rate, 2] for i in range(1, 4)])


def test_curves_treat_runs_of_one_name_as_seeds(tmp_path):
    for name, rate in (("paper_seed_0", 0.2), ("paper_seed_1", 0.6), ("no_tagd_seed_0", 0.4)):
        write_log(tmp_path / name, rate)
    (file,) = pictures.curves([tmp_path], tmp_path / "curves", [".svg"])
    text = file.read_text()
    assert "paper (mean of 2 seeds)" in text and "no_tagd" in text
    assert "range of the seeds" in text and "_seed_" not in text


def test_sources_and_formats_are_checked(tmp_path):
    with pytest.raises(ValueError, match=r"source=.*nowhere: no such"):
        pictures.curves([tmp_path / "nowhere"], tmp_path / "x")
    with pytest.raises(ValueError, match=r"no metrics\.csv or curve\.csv there"):
        pictures.curves([tmp_path], tmp_path / "x")
    write_log(tmp_path / "run", 0.5)
    with pytest.raises(ValueError, match=r"formats=\['\.bmp'\]"):
        pictures.curves([tmp_path], tmp_path / "x", [".bmp"])


@pytest.mark.slow
def test_each_picture_is_one_command(tmp_path, recording):
    recording.save(tmp_path / "episode.npz")
    names = sorted(path.stem for path in (CONF_DIR / "picture").glob("*.yaml"))
    assert {"curves", "rates", "attention", "tagd", "strip", "failures", "gif"} <= set(names)
    command = [sys.executable, "-m", "navrl.cli.plot"]
    words = ["picture=strip", "source=episode.npz", "out=deep/strip"]
    words.append("picture.formats=[.png,.pdf]")
    result = subprocess.run(
        [*command, *words], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr[-2000:]
    assert Image.open(tmp_path / "deep" / "strip.png").width > 800
    assert (tmp_path / "deep" / "strip.pdf").read_bytes().startswith(b"%PDF")


def test_robustness_draws_a_dot_for_each_policy(tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(
        robustness, "save_figure", lambda figure, file: saved.append(figure) or file
    )
    for name, kind, won in (("nominal", "nominal", 9), ("scan_01", "time", 5)):
        known = {"perturbation": {"name": name, "kind": kind, "about": f"about {name}"}}
        outcomes = [WON] * won + [HIT] * (10 - won)
        write_evaluation(tmp_path / name / "paper", "paper", outcomes, **known)
        known["privileged"] = True
        write_evaluation(tmp_path / name / "oracle", "oracle", [WON] * 10, **known)
    plot_robustness(find_evaluations([tmp_path]), tmp_path / "robustness.png")
    (axes,) = saved[0].axes
    assert [text.get_text() for text in axes.get_yticklabels()] == [
        "about nominal",
        "about scan_01",
    ]
    dots = {
        (line.get_marker(), *line.get_xdata()) for line in axes.lines if line.get_marker() != "None"
    }
    assert dots >= {("o", 0.9), ("o", 0.5), ("|", 1.0)}


def test_robustness_is_written_in_all_formats(tmp_path):
    known = {"perturbation": {"name": "nominal", "kind": "nominal", "about": "nominal"}}
    write_evaluation(tmp_path / "paper", "paper", [WON] * 10, **known)
    files = pictures.robustness([str(tmp_path)], tmp_path / "robustness")
    assert [file.suffix for file in files] == [".png", ".svg", ".pdf"]
    assert all(file.stat().st_size > 1000 for file in files)


def test_robustness_without_perturbed_evaluations_is_an_error(tmp_path):
    write_evaluation(tmp_path / "paper", "paper", [WON] * 10)
    with pytest.raises(ValueError, match="source: must have perturbed evaluations"):
        pictures.robustness([str(tmp_path)], tmp_path / "robustness")
