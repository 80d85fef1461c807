"""The layers, the sizes and the homes of dependencies, read from the code itself."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "navrl"
FILES = sorted(PACKAGE.rglob("*.py"))
RANK = {
    "keys": 0,
    "ops": 0,
    "checks": 0,
    "config": 0,
    "deprecation": 0,
    "deprecated_groups": 0,
    "extras": 0,
    "files": 0,
    "untrusted": 0,
    "processes": 0,
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
    "export": 6,
    "viz": 6,
    "benchmarks": 6,
    "factory": 7,
    "jobs": 8,
    "build": 8,
    "cli": 9,
}
HOMES = {
    "pybullet": ("sim/bullet_client.py",),
    "numba": ("ops/", "sim/batched.py"),
    "hydra": ("config.py", "factory/", "jobs/", "cli/"),
    "omegaconf": ("config.py", "factory/", "jobs/", "cli/"),
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
def test_dependencies_are_imported_only_where_allowed(path):
    place = names(path)
    for imported in imports(path):
        homes = HOMES.get(imported.split(".")[0])
        assert homes is None or place.startswith(homes), f"{place} imports {imported}"


def configured(code: str) -> list[str]:
    """Return the functions that take a configuration: a ``cfg``, or one of OmegaConf's types."""
    found = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            given = node.args
            every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
            for one in filter(None, every):
                kind = ast.unparse(one.annotation) if one.annotation else ""
                if one.arg == "cfg" or "DictConfig" in kind or "OmegaConf" in kind:
                    found.append(f"{getattr(node, 'name', 'lambda')}({one.arg})")
    return found


@pytest.mark.parametrize("path", FILES, ids=names)
def test_functions_below_the_factory_take_no_cfg(path):
    """They take values: a configuration of another shape changes the factory alone."""
    part = path.relative_to(PACKAGE).with_suffix("").parts[0]
    if part != "config" and RANK.get(part, 0) < RANK["factory"]:
        assert configured(path.read_text()) == []


def test_functions_with_a_cfg_are_found():
    code = "def a(x, cfg): ...\nclass B:\n    def c(self, *, node: DictConfig | None): ...\n"
    assert configured(f"{code}def d(config: dict): ...") == ["a(cfg)", "c(node)"]


def test_modules_have_no_import_cycles():
    """Imports under ``TYPE_CHECKING`` and within functions count."""
    modules = {module(path): path for path in FILES}
    arrows = {name: needed(path, modules) - {name} for name, path in modules.items()}
    assert circles(arrows) == []


def module(path: Path) -> str:
    """Return the dotted name of a file of the package."""
    parts = ("navrl", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(part for part in parts if part != "__init__")


def needed(path: Path, modules: dict[str, Path]) -> set[str]:
    """Return the modules of the package that a file imports by name."""
    found = imports(path) | {name.rpartition(".")[0] for name in imports(path)}
    return {name for name in found if name in modules and modules[name].name != "__init__.py"}


def circles(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Return each set of modules that can reach each other, largest first."""
    reach = {name: set(targets) for name, targets in arrows.items()}
    for middle in reach:
        for targets in reach.values():
            if middle in targets:
                targets |= reach[middle]
    rings = {tuple(sorted(b for b in reach[a] if a in reach[b])) for a in reach if a in reach[a]}
    return sorted((list(ring) for ring in rings), key=len, reverse=True)


def test_import_cycles_are_detected():
    arrows = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": set()}
    assert circles(arrows) == [["a", "b", "c"]]


@pytest.mark.parametrize("path", FILES, ids=names)
def test_files_are_short(path):
    assert len(path.read_text().splitlines()) <= 320
