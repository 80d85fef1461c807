"""Pictures need files alone: no simulator below them, no window, and nothing needs them."""

import ast
from pathlib import Path

import navrl

ROOT = Path(navrl.__file__).parent
ABOVE = {"viz", "factory", "jobs", "build.py", "cli"}


def imported(file):
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module


def test_viz_imports_no_simulation_and_no_window():
    files = list((ROOT / "viz").glob("*.py"))
    names = {name for file in files for name in imported(file)}
    ours = {name for name in names if name.startswith("navrl")}
    assert files
    files_alone = {
        f"navrl.evaluation.{name}"
        for name in ("recording", "recording_checks", "comparison", "robustness", "statistics")
    }
    files_alone |= {"navrl.evaluation.stored"}
    files_alone |= {"navrl.extras", "navrl.files", "navrl.untrusted"}
    files_alone |= {"navrl.worlds", "navrl.ops.bodies"}  # the scenario of a recording
    assert {n for n in ours if not n.startswith("navrl.viz")} <= files_alone
    assert not [n for n in names if n.startswith(("torch", "pybullet", "matplotlib.pyplot"))]


def test_nothing_below_imports_viz():
    for file in ROOT.rglob("*.py"):
        if file.relative_to(ROOT).parts[0] not in ABOVE:
            assert not [n for n in imported(file) if n.startswith("navrl.viz")], file
