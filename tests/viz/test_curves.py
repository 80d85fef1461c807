"""Learning curves: right numbers from logs with empty cells, runs and seeds told apart."""

import csv

import numpy as np
import pytest
from matplotlib.figure import Figure

from navrl.viz import curves, plot_curves

RATES = ("success", "collision_pedestrian", "collision_static", "timeout")
LOGGED = [f"train/{name}_rate" for name in RATES]
EVALUATED = [f"evaluation/{name}_rate" for name in RATES]
OTHER = ["train/max_dynamic", "reward/progress", "reward/collision", "learn/q_mean"]


def write_log(folder, success, interval=100):
    """A run of 12 reports, whose evaluations, after each 4th, succeed in so many cases."""
    folder.mkdir()
    with (folder / "metrics.csv").open("w", newline="") as file:
        columns = ["frames", "updates", *LOGGED, *OTHER, "learn/loss_critic", *EVALUATED]
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        for i in range(1, 13):
            at = {"frames": interval * i, "updates": i}
            values = [2 if i < 6 else 4, 0.3, -0.1, 1.5]
            writer.writerow(
                at
                | dict.fromkeys(LOGGED, 0.25)
                | dict(zip(OTHER, values, strict=True))
                | {"learn/loss_critic": 0.5}
            )
            if i % 4 == 0:
                writer.writerow(at | dict.fromkeys(EVALUATED, success))
    return folder / "metrics.csv"


@pytest.fixture
def figures(monkeypatch):
    """The figures that are saved."""
    saved = []
    monkeypatch.setattr(curves, "save_figure", lambda figure, file: saved.append(figure) or file)
    return saved


def line(axes, label):
    (found,) = [found for found in axes.lines if found.get_label() == label]
    return found.get_xdata(), found.get_ydata()


def test_empty_cells_are_not_drawn_as_zero(tmp_path, figures):
    plot_curves([write_log(tmp_path / "run", 0.8)], tmp_path / "curves")
    success, *_, level, reward, q, _ = figures[0].axes
    frames, values = line(success, "run")
    assert np.array_equal(frames, [400, 800, 1200])
    assert np.array_equal(values, [0.8] * 3)
    frames, values = line(reward, "run")
    assert len(frames) == 12
    assert values == pytest.approx(0.2)  # the sum of the terms
    assert line(q, "run")[1] == pytest.approx(1.5)
    assert set(level.lines[0].get_ydata()) == {2, 4}
    raised = [mark.get_xdata()[0] for mark in success.lines if mark.get_linestyle() == ":"]
    assert raised == [600]


def test_seeds_are_averaged_where_all_were_logged(tmp_path, figures):
    logs = [write_log(tmp_path / "a", 0.2), write_log(tmp_path / "b", 0.6, interval=50)]
    plot_curves(logs, tmp_path / "curves", labels=["same", "same"])
    frames, values = line(figures[0].axes[0], "same")
    assert np.array_equal(frames, [400, 600])
    assert values == pytest.approx(0.4)


def test_runs_have_distinct_colors(tmp_path, figures):
    logs = [write_log(tmp_path / name, 0.5) for name in ("one", "two")]
    plot_curves(logs, tmp_path / "curves")
    success = figures[0].axes[0]
    colors = {found.get_label(): found.get_color() for found in success.lines}
    assert colors["one"] != colors["two"]


def test_many_runs_are_distinguished_by_dashes(tmp_path, figures):
    logs = [write_log(tmp_path / f"run{i}", 0.5) for i in range(9)]
    plot_curves(logs, tmp_path / "curves", formats=(".png",))
    labeled = [drawn for drawn in figures[0].axes[0].lines if "run" in str(drawn.get_label())]
    assert len(labeled) == 9
    assert len({(drawn.get_color(), drawn.get_linestyle()) for drawn in labeled}) == 9


def test_png_and_svg_are_written(tmp_path):
    logs = [write_log(tmp_path / name, 0.5) for name in ("one", "two", "three")]
    labels = ["ours", "ours", "theirs"]
    files = plot_curves(logs, tmp_path / "out" / "curves.png", labels=labels)
    again = plot_curves(logs, tmp_path / "out" / "again", labels=labels)
    assert [file.suffix for file in files] == [".png", ".svg"]
    for first, second in zip(files, again, strict=True):
        assert first.read_bytes() == second.read_bytes()
    text = files[1].read_text()
    for words in ("ours (mean of 2 seeds)", "theirs", "environment steps", "share of episodes"):
        assert words in text


def test_new_run_without_rows_is_drawn(tmp_path):
    log = tmp_path / "metrics.csv"
    log.write_text("frames,updates,train/success_rate\n100,1,0.5\n")
    assert all(file.is_file() for file in plot_curves([log], tmp_path / "curves"))


def test_bundle_curve_has_axes_for_its_columns(tmp_path, figures):
    header = ",".join(["frames", "updates", "evaluation/max_dynamic", *EVALUATED])
    rows = ["100,1,2,0.3,0.4,0.2,0.1", "200,2,4,0.6,0.2,0.2,0"]
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "curve.csv").write_text("\n".join([header, *rows, ""]))
    plot_curves(sorted(tmp_path.rglob("curve.csv")), tmp_path / "curves")
    titles = [axes.get_title() for axes in figures[0].axes]
    assert titles == [panel.title for panel in curves._PANELS[:5]]
    success, *_, level = figures[0].axes
    assert np.array_equal(line(success, "two")[1], [0.3, 0.6])
    assert np.array_equal(level.lines[0].get_ydata(), [2, 4])
    texts = {text.get_text() for text in figures[0].legends[0].get_texts()}
    assert texts == {"one", "two", "evaluation, no exploration"}


def test_bad_logs_are_named(tmp_path):
    (tmp_path / "empty.csv").write_text("frames,updates\n")
    with pytest.raises(ValueError, match=r"empty\.csv"):
        plot_curves([tmp_path / "empty.csv"], tmp_path / "curves")
    with pytest.raises(FileNotFoundError, match=r"none\.csv"):
        plot_curves([tmp_path / "none.csv"], tmp_path / "curves")
    with pytest.raises(ValueError, match="label"):
        plot_curves([], tmp_path / "curves")
    with pytest.raises(ValueError, match="label"):
        plot_curves([tmp_path / "empty.csv"], tmp_path / "curves", labels=["a", "b"])


def test_matplotlib_settings_are_restored(tmp_path):
    import matplotlib

    before = dict(matplotlib.rcParams)
    plot_curves([write_log(tmp_path / "run", 0.5)], tmp_path / "curves")
    assert dict(matplotlib.rcParams) == before
    assert Figure().get_dpi() == before["figure.dpi"]
