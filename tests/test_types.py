"""Pyright finds no type error in the typed packages, and no more than are left in the others."""

import json
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.version import Version

ROOT = Path(__file__).parents[1]
TYPED = ("deploy", "envs", "networks", "ops", "policies", "sim", "transforms")
# Errors that are left elsewhere, at most; a change that removes some lowers these.
LEFT = {
    "algos": 18,
    "benchmarks": 14,
    "cli": 1,
    "config.py": 1,
    "evaluation": 12,
    "factory": 5,
    "jobs": 9,
    "training": 13,
    "viz": 49,
    "worlds": 3,
}
# The counts depend on the annotations of these.
ANNOTATED = ("gymnasium", "matplotlib", "numba", "numpy", "omegaconf", "pyright")
ANNOTATED += ("tensordict", "torch", "torchrl")


def other_versions() -> list[str]:
    """Return the packages whose versions are not those of constraints.txt."""
    pins = dict(re.findall(r"^(\S+)==(\S+)", (ROOT / "constraints.txt").read_text(), re.M))
    installed = {name: Version(version(name)).base_version for name in ANNOTATED}
    return [f"{name} {found}" for name, found in installed.items() if found != pins[name]]


def type_errors() -> dict[str, list[str]]:
    """Return pyright's errors, each in a line, by package or module of navrl."""
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode in (0, 1), run.stderr  # 1: there are errors
    assert "unrecognized setting" not in run.stderr, run.stderr
    report = json.loads(run.stdout)
    assert report["summary"]["filesAnalyzed"] > 200
    found = {}
    for item in report["generalDiagnostics"]:
        if item["severity"] == "error":
            file, line = Path(item["file"]), item["range"]["start"]["line"] + 1
            place = f"{file.relative_to(ROOT)}:{line}"
            text = f"{place}: {item['message']} ({item.get('rule')})"
            found.setdefault(file.relative_to(ROOT / "navrl").parts[0], []).append(text)
    return found


def test_type_errors_do_not_increase():
    """One test, so that it runs pyright once on any number of cores."""
    others = other_versions()
    if others:
        pytest.skip(f"counted with other versions: {', '.join(others)}")
    found = type_errors()
    more = [part for part, lines in found.items() if len(lines) > LEFT.get(part, 0)]
    assert not more, "\n".join(line for part in more for line in found[part])
    assert not set(TYPED) & LEFT.keys()
    assert all((ROOT / "navrl" / part).exists() for part in (*TYPED, *LEFT))
