"""The page on places of one's own: its files, evaluation, comparison, picture and report."""

import json
from pathlib import Path

import pages
import pytest

pytest.importorskip("plotly")

PAGE = pages.ROOT / "docs" / "places.md"
TINY = ["suite.num_episodes=4", "num_worlds=2", "environment.time_limit_steps=3"]
TINY += ["progress_bar=false", "num_threads=1"]


def test_printed_commands_run_in_order(tmp_path, monkeypatch):
    for name, text in pages.files(PAGE).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    for code in pages.blocks(PAGE, "python"):
        exec(compile(code, PAGE.name, "exec"), {"__name__": "snippet"})
    commands = pages.commands(PAGE)
    assert len(commands) == 11
    for number, command in enumerate(commands):
        tiny = TINY if command.startswith("navrl-evaluate") else ()
        own = () if "run.dir" in command or not tiny else (f"hydra.run.dir=run_{number}",)
        pages.run(command, *tiny, *own)
    summary = json.loads(Path("outputs/evaluate/places/paper/summary.json").read_text())
    assert (summary["episodes"], summary["errors"]) == (4, 0)
    assert list(summary["by_scenario"]) == ["hall"]
    assert len(summary["data"]["sha256"]) == 64
    assert len(list(Path("outputs/plot").rglob("strip.png"))) == 1


def test_absent_folder_is_one_line_and_no_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    command = next(line for line in pages.commands(PAGE) if "policy=dwa" in line)
    pages.run(command, *TINY)
    assert "my_places" in capsys.readouterr().out
    assert not list(tmp_path.rglob("summary.json"))
