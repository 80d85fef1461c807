"""Hooks, templates and workflows parse, and use the tools and versions of the project."""

import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
HIDDEN = [
    ".pre-commit-config.yaml",
    *(".github/" + name for name in ("ISSUE_TEMPLATE", "workflows")),
]
# Findings of ruff that are left, at most; a change that removes some lowers these.
LEFT = {"ANN001": 611, "ANN201": 96, "ANN401": 35, "D102": 24, "D105": 30, "D107": 105}


def yaml_files() -> list[Path]:
    files = [path for name in HIDDEN for path in ([ROOT / name, *(ROOT / name).rglob("*.yml")])]
    return [path for path in files if path.is_file()]


@pytest.mark.parametrize("path", yaml_files(), ids=lambda path: path.name)
def test_yaml_of_the_project_parses(path):
    assert yaml.safe_load(path.read_text())


def test_hooks_have_the_versions_of_the_constraints():
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"][0]["hooks"]
    pins = (ROOT / "constraints.txt").read_text().splitlines()
    for hook in hooks:
        for pin in hook["additional_dependencies"]:
            assert re.fullmatch(r"[\w-]+==[\d.]+", pin)
            assert not pin.startswith("ruff") or pin in pins


def test_the_workflow_runs_the_ci_script():
    text = (ROOT / ".github" / "workflows" / "tests.yml").read_text()
    assert "bash .ci/run" in text and "-c constraints.txt" in text


def test_slow_tests_run_every_night():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text())
    nightly = workflow["jobs"]["nightly"]
    assert workflow[True]["schedule"] and nightly["if"] == "github.event_name == 'schedule'"
    commands = [step["run"] for step in nightly["steps"] if "run" in step]
    assert commands[-1] == "python -m pytest -n auto --run-slow"


def test_missing_annotations_and_docstrings_do_not_increase():
    command = [sys.executable, "-m", "ruff", "check", "--no-cache", "--output-format", "concise"]
    command += ["--select", ",".join(LEFT), "--ignore", "E", "navrl"]
    shown = subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout
    counted = Counter(re.findall(r"^navrl/\S+ ([A-Z]+\d+) ", shown, re.M))
    assert {rule: n for rule, n in counted.items() if n > LEFT[rule]} == {}
    assert counted.keys() == LEFT.keys()
