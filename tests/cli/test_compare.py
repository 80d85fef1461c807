"""``navrl-compare A B``: folders as words, errors in a line."""

import subprocess
import sys

from evaluated import HIT, WON, write_evaluation


def compare(folder, *words):
    return subprocess.run(
        [sys.executable, "-m", "navrl.cli.compare", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_folder_arguments_use_the_first_as_reference(tmp_path):
    write_evaluation(tmp_path / "policy=paper", "paper", [WON, WON, HIT])
    write_evaluation(tmp_path / "b", "dwa", [WON, HIT, HIT])
    done = compare(tmp_path, "policy=paper", "b", "out=tables")
    assert done.returncode == 0, done.stderr[-3000:]
    assert "success vs `paper`" in done.stdout
    assert "-33.3" in done.stdout
    names = {file.name for file in (tmp_path / "tables").iterdir()}
    assert names == {f"comparison{end}" for end in (".md", ".csv", ".json", "_metrics.csv")}
    left = {file.name for file in tmp_path.iterdir()}
    assert left == {"policy=paper", "b", "tables"}  # no run folder, no log


def test_different_episodes_are_a_one_line_error(tmp_path):
    write_evaluation(tmp_path / "a", "paper", [WON])
    write_evaluation(tmp_path / "b", "dwa", [WON], suite_hash="other")
    done = compare(tmp_path, "a", "b")
    assert done.returncode == 2
    assert "not the same episodes" in done.stderr and done.stderr.count("\n") == 1
