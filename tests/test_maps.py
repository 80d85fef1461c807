"""The page on maps of one's own: its files, evaluation, picture, report and paths."""

import contextlib
import json
from pathlib import Path

import numpy as np
import pages
import pytest

from navrl.worlds import load_map, load_occupancy_map

pytest.importorskip("plotly")

PAGE = pages.ROOT / "docs" / "maps.md"
TINY = ["suite.num_episodes=4", "num_worlds=2", "environment.time_limit_steps=3"]
TINY += ["progress_bar=false", "num_threads=1"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Write the files of the page into an empty folder."""
    for name, text in pages.files(PAGE).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    run_code(pages.blocks(PAGE, "python")[0])
    return tmp_path


def run_code(code):
    exec(compile(code, PAGE.name, "exec"), {"__name__": "snippet"})


@pytest.mark.slow
def test_map_becomes_an_evaluated_and_reported_suite(folder):
    commands = pages.commands(PAGE)
    assert len(commands) == 6
    for command in commands:
        pages.run(command, *(TINY if command.startswith("navrl-evaluate") else ()))
    summary = json.loads(Path("outputs/evaluate/maps/paper/summary.json").read_text())
    assert (summary["episodes"], summary["errors"]) == (4, 0)
    assert list(summary["by_scenario"]) == ["office"] and len(summary["data"]["sha256"]) == 64
    assert len(list(Path("outputs/plot").rglob("strip.png"))) == 1


def test_printed_office_has_two_rooms_and_a_corridor(folder, capsys):
    office = load_map("my_maps/office.yaml")
    inside = office.free.contains([[-4.0, 2.0], [3.0, 1.0], [0.0, -2.0], [-2.2, 1.0], [-5.5, 0.0]])
    assert inside.tolist() == [True, True, True, False, False]
    run_code(pages.blocks(PAGE, "python")[1])
    clearance = float(capsys.readouterr().out.split()[-2])
    assert 0.23 <= clearance <= 0.45  # half a door
    path = load_occupancy_map("my_maps/office.yaml").path([-4.0, 2.0], [3.0, 1.0])
    assert path[:, 1].min() < -1.0 and np.hypot(*(path[-1] - [3.0, 1.0])) < 1e-9


def test_malformed_map_ends_the_command_with_its_name_and_value(folder, capsys):
    file = Path("my_maps/office.yaml")
    file.write_text(file.read_text().replace("resolution: 0.05", "resolution: 0"))
    with contextlib.suppress(SystemExit):
        pages.run(pages.commands(PAGE)[1], *TINY)
    error = capsys.readouterr().err
    assert "office.yaml: resolution=0: must be a number in 0.001 to 10" in error
