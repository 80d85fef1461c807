"""The README's commands and snippets are what they say."""

import re
import shlex
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from navrl.cli import suites
from navrl.cli.report import make_parser
from navrl.config import compose

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), re.S)


def test_the_first_screen_has_two_commands_that_set_themselves_up():
    first, second = blocks(ROOT / "README.md", "bash")
    assert (ROOT / "README.md").read_text().index(second) < 2500
    for command in (first, second):
        assert command.count("\n") == 1
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install")
    assert first.strip().endswith("navrl-train")
    assert second.strip().endswith("pytest")
    assert '".[test,docs]"' in second  # or the site's tests are skipped where they count


def test_readme_names_the_other_project_first_and_is_short():
    text = (ROOT / "README.md").read_text()
    assert "UAV" in "\n".join(text.splitlines()[:6])
    assert len(text.splitlines()) <= 150


def test_ci_runs_the_readmes_test_command():
    script = (ROOT / ".ci" / "run").read_text()
    assert "README.md" in script
    assert '"pytest" in block' in script


SNIPPETS = [(page.name, code) for page in PAGES for code in blocks(page, "python")]


@pytest.mark.parametrize(("page", "code"), SNIPPETS, ids=[name for name, _ in SNIPPETS])
def test_python_snippets_run(page, code, capsys):
    exec(compile(code, page, "exec"), {"__name__": "snippet"})
    assert capsys.readouterr().out


def shell_commands():
    for page in PAGES:
        for block in blocks(page, "sh"):
            for line in block.splitlines():
                words = shlex.split(line.split("#")[0])
                if words and words[0].startswith("navrl-"):
                    yield page.name, words


@pytest.mark.parametrize(("page", "words"), list(shell_commands()), ids=lambda v: str(v)[:60])
def test_shell_commands_compose(page, words):
    """Every printed override exists; sweeps are tried job by job."""
    if words[0] == "navrl-report":  # no Hydra: folders are what it takes
        assert make_parser().parse_args(words[1:]).folders
        return
    if words[0] == "navrl-suites":  # nor here, and it is quick
        assert suites.main(words[1:]) == 0
        return
    launcher = ("hydra/launcher=", "hydra.launcher.")  # need plugins: tried in test_launchers.py
    overrides = [w for w in words[1:] if "=" in w and not w.startswith(launcher)]
    if any(w.startswith("-") for w in words[1:] if w not in ("-m", "--cfg")):
        return  # --config-dir: tried in test_extending.py
    chosen = []
    for override in OverridesParser.create().parse_overrides(overrides):
        values = override.sweep_string_iterator() if override.is_sweep_override() else None
        assert values is None or "-m" in words, override.input_line
        key = override.get_key_element()
        chosen.append(f"{key}={next(values)}" if values else override.input_line)
    compose(words[0].removeprefix("navrl-"), chosen)
