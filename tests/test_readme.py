"""The README's commands and snippets are what they say."""

import sys

import pytest
from pages import PAGES, ROOT, blocks, files


def test_readme_begins_with_two_complete_commands():
    first, second = blocks(ROOT / "README.md", "bash")
    assert (ROOT / "README.md").read_text().index(second) < 2500
    for command in (first, second):
        assert command.count("\n") == 1
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install")
    assert first.strip().endswith("navrl-train")
    assert second.strip().endswith("pytest -n auto")
    assert '".[test,docs]"' in second  # or the site's tests are skipped where they count


def test_readme_names_the_other_project_first_and_is_short():
    text = (ROOT / "README.md").read_text()
    assert "UAV" in "\n".join(text.splitlines()[:6])
    assert len(text.splitlines()) <= 150


def test_ci_runs_the_readmes_test_command():
    script = (ROOT / ".ci" / "run").read_text()
    assert "README.md" in script
    assert '"pytest" in block' in script


CHAINED = (
    "maps.md",
)  # each snippet needs the files of the one before; tests/test_maps.py runs them
SNIPPETS = [
    (page, code) for page in PAGES if page.name not in CHAINED for code in blocks(page, "python")
]


@pytest.fixture
def printed_modules(tmp_path):
    """Forget afterwards what was imported from a page's files, and nothing else."""
    yield
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None)).startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.mark.parametrize(("page", "code"), SNIPPETS, ids=[page.name for page, _ in SNIPPETS])
@pytest.mark.usefixtures("printed_modules")
def test_python_snippets_run(page, code, capsys, tmp_path, monkeypatch):
    """As a script in a folder that holds the files which the page prints."""
    for name, text in files(page).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    exec(compile(code, page.name, "exec"), {"__name__": "snippet"})
    assert capsys.readouterr().out
