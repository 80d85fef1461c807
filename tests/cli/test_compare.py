"""``navrl-compare A B``: folders as words, errors in a line."""

import shlex

import pages
import pytest
from evaluated import HIT, WON, write_evaluation


@pytest.fixture
def compare(tmp_path, monkeypatch, capfd):
    """Return a function that runs the command there; it returns exit status, output and errors."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        status = pages.exit_status(shlex.join(["navrl-compare", *words]))
        return status, *capfd.readouterr()

    return run


def test_folder_arguments_use_the_first_as_reference(tmp_path, compare):
    write_evaluation(tmp_path / "policy=paper", "paper", [WON, WON, HIT])
    write_evaluation(tmp_path / "b", "dwa", [WON, HIT, HIT])
    status, printed, errors = compare("policy=paper", "b", "out=tables")
    assert status == 0, errors
    assert "success vs `paper`" in printed
    assert "-33.3" in printed
    names = {file.name for file in (tmp_path / "tables").iterdir()}
    assert names == {f"comparison{end}" for end in (".md", ".csv", ".json", "_metrics.csv")}
    left = {file.name for file in tmp_path.iterdir()}
    assert left == {"policy=paper", "b", "tables"}  # no run folder, no log


def test_different_episodes_are_a_one_line_error(tmp_path, compare):
    write_evaluation(tmp_path / "a", "paper", [WON])
    write_evaluation(tmp_path / "b", "dwa", [WON], suite_hash="other")
    status, _, errors = compare("a", "b")
    assert status == 2
    assert "not the same episodes" in errors and errors.count("\n") == 1
