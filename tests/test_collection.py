"""pytest collects every test file, and ruff checks every source file."""

import ast
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

# pytest's own search for files, without importing what it finds.
COLLECT = """
import json, sys
import pytest

class Listing(pytest.Collector):
    def collect(self):
        return []

class Recorder:
    found = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_pycollect_makemodule(self, module_path, parent):
        self.found.append(str(module_path))
        return Listing.from_parent(parent, path=module_path, name=module_path.name)

options = ["--collect-only", "-qq", "-p", "no:cacheprovider", "--noconftest"]
pytest.main(options, plugins=[Recorder()])
print(json.dumps(Recorder.found))
"""


def files(*folders: str, pattern: str = "*.py") -> set[Path]:
    return {path for folder in folders for path in (ROOT / folder).rglob(pattern)}


def output(*command: str) -> str:
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout


def test_pytest_collects_every_test_file():
    collected = json.loads(output(sys.executable, "-c", COLLECT).splitlines()[-1])
    on_disk = files("tests", pattern="test_*.py")
    assert {Path(path) for path in collected} == on_disk


def test_test_functions_are_in_collected_files():
    for path in files("tests") - files("tests", pattern="test_*.py"):
        tree = ast.parse(path.read_text())
        functions = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
        assert not [name for name in functions if name.startswith("test_")], path


def test_ruff_checks_every_source_file():
    shown = output(sys.executable, "-m", "ruff", "check", "--show-files", "navrl", "tests")
    assert {Path(line) for line in shown.split("\n") if line} == files(
        "navrl", "tests", pattern="*.py*"
    ) - files("navrl", "tests", pattern="*.pyc")
