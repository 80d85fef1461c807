"""Dockerfile and devcontainer install and test the project as README and CI do."""

import json
import re
import tomllib
from pathlib import Path

import yaml
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[1]
DOCKERFILE = (ROOT / "Dockerfile").read_text().replace("\\\n", "")
DEVCONTAINER = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text())


def readme_command() -> str:
    blocks = re.findall(r"```bash\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    (command,) = (block.strip() for block in blocks if "pytest" in block)
    return command


def instructions(name: str) -> list[str]:
    return re.findall(rf"^{name} (.*)$", DOCKERFILE, re.M)


def test_image_has_a_supported_python_the_one_of_ci():
    image = instructions("FROM")[0]
    version = re.fullmatch(r"python:([\d.]+)-slim-bookworm AS base", image)[1]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert SpecifierSet(project["requires-python"]).contains(version)
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "tests.yml").read_text())
    setup = next(step for step in workflow["jobs"]["ci"]["steps"] if "with" in step)
    assert setup["with"]["python-version"] == version


def test_image_runs_the_readmes_test_command():
    install, run = instructions("RUN")[-1], instructions("CMD")[-1]
    assert f"{install} && {run}" == readme_command()


def test_image_has_the_system_packages_of_ci():
    (install,) = (line for line in instructions("RUN") if "apt-get install" in line)
    wanted = re.search(r"apt-get install -y -qq ([\w ]+)", (ROOT / ".ci" / "run").read_text())[1]
    assert set(wanted.split()) <= set(install.split())


def test_devcontainer_installs_as_the_readme():
    install, _, _ = readme_command().rpartition(" && ")
    assert DEVCONTAINER["postCreateCommand"] == install
    build = DEVCONTAINER["build"]
    assert (ROOT / ".devcontainer" / build["dockerfile"]).resolve() == ROOT / "Dockerfile"
    assert (ROOT / ".devcontainer" / build["context"]).resolve() == ROOT
    assert f" AS {build['target']}" in "\n".join(instructions("FROM"))


def test_image_contains_no_environment_or_results():
    ignored = {line.removeprefix("**/").strip("/") for line in lines(".dockerignore")}
    assert {line.strip("/") for line in lines(".gitignore")} | {".git"} == ignored


def lines(name: str) -> list[str]:
    read = (ROOT / name).read_text().splitlines()
    return [line for line in read if line and not line.startswith("#")]
