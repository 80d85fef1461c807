"""docs/supported.md lists the public packages, commands, config groups and extras there are."""

import ast
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "supported.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def section(title: str) -> str:
    return re.split(r"^## ", PAGE.partition(f"## {title}\n")[2], flags=re.M)[0]


def packages_with_all() -> set[str]:
    found = set()
    for path in (ROOT / "navrl").rglob("__init__.py*"):  # of lazy exports the stub has the names
        assigned = [
            node for node in ast.parse(path.read_text()).body if isinstance(node, ast.Assign)
        ]
        targets = [ast.unparse(target) for node in assigned for target in node.targets]
        if "__all__" in targets:
            found.add(".".join(path.parent.relative_to(ROOT).parts))
    return found


def test_the_page_lists_each_package_as_public_or_internal():
    text = section("Python")
    public = set(re.findall(r"^\| `([\w.]+)`", text, re.M))
    internal = set(re.findall(r"`([\w.]+)`", text.partition("Internal packages:")[2]))
    folders = {f"navrl.{path.parent.name}" for path in (ROOT / "navrl").glob("*/__init__.py")}
    assert not public & internal
    assert public == (packages_with_all() | {"navrl.ops"}) - internal
    assert folders <= public | internal


def test_the_page_lists_each_command():
    assert set(re.findall(r"`(navrl-[\w-]+)`", section("Commands"))) == PROJECT["scripts"].keys()


def test_the_page_lists_each_config_group():
    groups = {path.name for path in (ROOT / "conf").iterdir() if path.is_dir()}
    groups.remove("base")  # inherited, not chosen
    assert set(re.findall(r"`([\w]+)`", section("Configuration").partition("groups:")[2])) == groups


def test_the_page_lists_each_extra():
    rows = re.findall(r"^\| (`.*?) \|", section("Packages"), re.M)
    names = {name for row in rows for name in re.findall(r"`([\w-]+)`", row)}
    assert names == PROJECT["optional-dependencies"].keys()


def test_versions_are_the_same_everywhere():
    from navrl import __version__

    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text()
    assert f"navrl-{__version__}-py3" in (ROOT / "docs" / "releasing.md").read_text()


def test_changelog_headings_are_those_of_keep_a_changelog():
    headings = re.findall(r"^### (.*)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert set(headings) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert {"Added", "Changed", "Fixed"} <= set(headings)
