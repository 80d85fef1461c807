"""Which packages an import needs, and how documentation and messages say to install them."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
FULL = ("pybullet", "hydra", "omegaconf", "matplotlib", "skimage", "scipy", "PIL", "safetensors")
FULL += ("tensorboard", "tqdm", "yaml")

# Imports with some packages hidden, as if they were not installed.
HIDE = """
import importlib.util, sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {hidden}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
find_spec = importlib.util.find_spec
importlib.util.find_spec = lambda name, *a: None if name in {hidden} else find_spec(name, *a)
sys.meta_path.insert(0, Hidden())
{code}
"""


def run(code: str, hidden: tuple[str, ...] = FULL) -> subprocess.CompletedProcess:
    script = HIDE.format(hidden=set(hidden), code=code)
    return subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)


def names(requirements: list[str]) -> set[str]:
    return {Requirement(line).name.lower() for line in requirements}


@pytest.fixture(scope="module")
def with_base_packages():
    """A process that imports what the base suffices for, then what needs an extra."""
    return run(
        "import torch, gymnasium, navrl\n"
        "from tensordict import TensorDict\n"
        "from navrl.transforms import MinPool\n"
        "from navrl import networks, sim, algos\n"
        "pool = MinPool(group_size=4, in_keys=['scan'], out_keys=['pooled', 'points', 'hit'])\n"
        "print(pool(TensorDict({'scan': torch.rand(2, 360)}, [2]))['points'].shape)\n"
        "for module in ('envs', 'factory', 'worlds'):\n"
        "    try:\n        importlib.import_module(f'navrl.{module}')\n"
        "    except ModuleNotFoundError as error:\n        print(module, error)\n"
        "sim.BatchedSimulator\n",
    )


@pytest.mark.slow
def test_base_packages_suffice_for_transforms_and_networks(with_base_packages):
    done = with_base_packages
    assert "[2, 90, 2]" in done.stdout, done.stderr[-2000:]


@pytest.mark.parametrize("module", ["envs", "factory", "worlds"])
def test_a_missing_extra_is_named(module, with_base_packages):
    (line,) = [x for x in with_base_packages.stdout.splitlines() if x.startswith(f"{module} ")]
    assert line.startswith(f"{module} navrl.")
    assert "skimage" in line and "pip install -e '.[full]' in a clone of navrl" in line


def test_command_without_its_extra_is_a_one_line_error():
    done = run("from navrl.cli.train import main; main()")
    assert done.returncode == 1 and len(done.stderr.strip().splitlines()) == 1
    assert done.stderr.startswith("navrl: the commands: needs hydra")


def test_ranges_are_open_and_the_constraints_are_within_them():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = dict(line.lower().split("==") for line in lines if not line.startswith("#"))
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines if not line.startswith("#"))
    wanted = [*PROJECT["dependencies"], *EXTRAS["full"], *EXTRAS["test"], *EXTRAS["docs"]]
    for requirement in map(Requirement, wanted):
        if requirement.name == "navrl":
            continue
        assert not any(part.operator == "==" for part in requirement.specifier), requirement
        pin = pins[requirement.name.lower()]
        assert requirement.specifier.contains(pin), (requirement, pin)


def test_pinned_packages_accept_the_first_python_of_the_range():
    """Debian 12 has 3.11.2: a pin that needs a later patch release cannot be installed there."""
    first = f"{PROJECT['requires-python'].split(',')[0].removeprefix('>=')}.0"
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    for name, pin in (line.split("==") for line in lines if not line.startswith("#")):
        try:
            installed = metadata(name)
        except PackageNotFoundError:
            continue
        if installed["Version"] == pin:
            needed = SpecifierSet(installed["Requires-Python"] or "")
            assert needed.contains(first), f"{name}=={pin} needs Python {needed}"


def test_base_dependencies_are_few():
    base = names(PROJECT["dependencies"])
    assert base == {"torch", "torchrl", "tensordict", "gymnasium", "numba", "numpy"}
    assert not base & names(EXTRAS["full"])


def test_python_classifiers_match_the_range():
    versions = [
        line.rsplit(" ", 1)[1] for line in PROJECT["classifiers"] if ":: Python :: 3." in line
    ]
    minors = [int(version.removeprefix("3.")) for version in versions]
    assert minors == list(range(min(minors), max(minors) + 1))
    assert PROJECT["requires-python"] == f">=3.{min(minors)},<3.{max(minors) + 1}"


def test_no_text_claims_a_package_index():
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout
    suffixes = {".py", ".md", ".yaml", ".yml", ".toml", ".cff", ".txt"}
    paths = [ROOT / line for line in listed.splitlines()] or [
        path
        for path in ROOT.rglob("*.*")
        if not any(part[0] == "." for part in path.relative_to(ROOT).parts)
    ]
    for path in paths:
        if path.suffix in suffixes and path.is_file() and path != Path(__file__):
            found = re.search(r"pip install (?:-\S+ )*['\"]?navrl\b", path.read_text())
            assert found is None, f"{path}: {found[0]}"


def test_extras_named_in_the_texts_exist():
    paths = [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", *(ROOT / "conf").rglob("*.yaml")]
    paths += (ROOT / "navrl").rglob("*.py")
    for path in paths:
        for extras in re.findall(r"pip install[^\n]*?\.\[([\w,-]+)\]", path.read_text()):
            assert set(extras.split(",")) <= EXTRAS.keys(), (path, extras)
