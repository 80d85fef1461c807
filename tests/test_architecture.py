"""The layers, the sizes and the homes of dependencies, read from the code itself."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "navrl"
FILES = sorted(PACKAGE.rglob("*.py"))
RANK = {
    "keys": 0,
    "ops": 0,
    "config": 0,
    "files": 0,
    "progress_bar": 0,
    "worlds": 1,
    "sim": 2,
    "transforms": 2,
    "networks": 2,
    "envs": 3,
    "algos": 3,
    "policies": 4,
    "training": 5,
    "evaluation": 5,
    "deploy": 5,
    "viz": 6,
    "benchmarks": 6,
    "build": 7,
    "cli": 8,
}
HOMES = {
    "pybullet": ("sim/bullet.py", "sim/"),
    "numba": ("ops/", "sim/batched.py"),
    "hydra": ("config.py", "build/", "cli/"),
    "omegaconf": ("config.py", "build/", "cli/"),
}


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def names(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


@pytest.mark.parametrize("path", FILES, ids=names)
def test_imports_point_down(path):
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    if parts == ("__init__",):
        return
    for imported in imports(path):
        if imported.startswith("navrl.") and imported.split(".")[1] in RANK:
            other = imported.split(".")[1]
            assert other == parts[0] or RANK[other] <= RANK[parts[0]], imported


@pytest.mark.parametrize("path", FILES, ids=names)
def test_dependencies_stay_at_home(path):
    place = names(path)
    for imported in imports(path):
        homes = HOMES.get(imported.split(".")[0])
        assert homes is None or place.startswith(homes), f"{place} imports {imported}"


@pytest.mark.parametrize("path", FILES, ids=names)
def test_files_are_short(path):
    assert len(path.read_text().splitlines()) <= 320
