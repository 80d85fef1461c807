"""The wheel and the sdist carry conf/, and the commands find it from anywhere."""

import importlib.util
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from navrl import __version__
from navrl.config import CONF_DIR

ROOT = Path(__file__).parents[1]


def run(*command, cwd):
    result = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stderr[-3000:]
    return result.stdout


@pytest.fixture(scope="module")
def built(once):
    folder = once("dist", build)
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def build(folder):
    code = (
        "from hatchling.build import build_wheel, build_sdist; import sys\n"
        "print(build_wheel(sys.argv[1])); print(build_sdist(sys.argv[1]))"
    )
    assert len(run(sys.executable, "-c", code, str(folder), cwd=ROOT).split()) == 2


def test_wheel_and_sdist_contain_all_of_conf(built):
    wheel, sdist = built
    wanted = {str(p.relative_to(CONF_DIR)) for p in CONF_DIR.rglob("*.yaml")}
    with zipfile.ZipFile(wheel) as archive:
        got = {n.removeprefix("navrl/conf/") for n in archive.namelist() if "/conf/" in n}
    assert wanted == got
    with tarfile.open(sdist) as archive:
        names = {n.split("/", 1)[1] for n in archive.getnames() if "/" in n}
    assert {f"conf/{name}" for name in wanted} <= names
    assert {"README.md", "LICENSE", ".ci/run", "tests/test_packaging.py"} <= names


def long_description(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return archive.read(name).decode().partition("\n\n")[2]


def test_long_description_has_no_relative_picture(built):
    shown = long_description(built[0])
    assert "Results has all approaches" in shown and "](docs/" not in shown and "![" not in shown
    assert "Description-Content-Type" not in shown and len(shown) > 2000


def test_long_description_has_the_addresses_of_the_release(tmp_path):
    address = "https://example.org/navrl"
    code = "from hatchling.build import build_wheel; import sys; print(build_wheel(sys.argv[1]))"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NAVRL_REPOSITORY_URL", f"{address}/")
        run(sys.executable, "-c", code, str(tmp_path), cwd=ROOT)
    shown = long_description(next(tmp_path.glob("*.whl")))
    assert f"]({address}/raw/v{__version__}/docs/assets/paper.gif)" in shown
    assert f"[Results]({address}/blob/v{__version__}/docs/results.md)" in shown
    assert "](docs/" not in shown


@pytest.fixture(scope="module")
def hook():
    """The module ``hatch_build.py``, which is no part of the package."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def updated(hook, **metadata):
    hook.CustomMetadataHook(str(ROOT), {}).update(metadata)
    return metadata["readme"]["text"]


def test_build_without_an_address_reports_it(hook, monkeypatch, capsys):
    monkeypatch.delenv(hook.VARIABLE, raising=False)
    assert "![" not in updated(hook, urls={"Paper": "https://arxiv.org/abs/2310.19670"})
    assert "NAVRL_REPOSITORY_URL is not set: the package's description" in capsys.readouterr().err


def test_address_comes_from_the_projects_urls(hook, monkeypatch, capsys):
    urls = {"Repository": "https://example.org/a/b/"}
    monkeypatch.delenv(hook.VARIABLE, raising=False)
    assert f"](https://example.org/a/b/raw/v{__version__}/docs/assets/" in updated(hook, urls=urls)
    monkeypatch.setenv(hook.VARIABLE, "https://example.org/c")
    assert f"](https://example.org/c/raw/v{__version__}/docs/assets/" in updated(hook, urls=urls)
    assert not capsys.readouterr().err


@pytest.mark.parametrize("address", ["navrl", "https://example.org", "git@example.org:a/b", "/a/b"])
def test_address_that_is_no_web_page_is_an_error(hook, address):
    with pytest.raises(ValueError, match=r"NAVRL_REPOSITORY_URL=.*: must be the web address"):
        hook.repository_address({hook.VARIABLE: address}, {})


@pytest.mark.parametrize(
    "text, expected",
    [
        ("![a b](./docs/a.png)", "![a b](https://x.org/y/raw/v1/docs/a.png)"),
        ('![a](docs/a.png "Title")', '![a](https://x.org/y/raw/v1/docs/a.png "Title")'),
        ("[a](docs/a.md#part)", "[a](https://x.org/y/blob/v1/docs/a.md#part)"),
        ("[a](https://z.org/a) [b](#part)", "[a](https://z.org/a) [b](#part)"),
    ],
)
def test_relative_links_become_absolute(hook, text, expected):
    assert hook.absolute_links(text, "https://x.org/y", "1") == expected


@pytest.mark.parametrize(
    "text", ['<img src="docs/a.png">', "[a]: docs/a.md", "[![a](docs/a.png)](docs/a.md)"]
)
@pytest.mark.parametrize("repository", ["", "https://x.org/y"])
def test_relative_links_of_other_forms_are_errors(hook, text, repository):
    with pytest.raises(ValueError, match=r"must be written as \[text\]\(path\)"):
        hook.absolute_links(text, repository, "1")


def test_wheel_and_sdist_contain_modules_and_type_marker(built):
    wheel, sdist = built
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "navrl").rglob("*.py")}
    modules.add("navrl/networks/weights/scan_flow.safetensors")
    with zipfile.ZipFile(wheel) as archive:
        assert modules | {"navrl/py.typed"} <= set(archive.namelist())
    tests = {str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob("*.py")}
    with tarfile.open(sdist) as archive:
        names = {n.split("/", 1)[1] for n in archive.getnames() if "/" in n}
    project = {"constraints.txt", ".pre-commit-config.yaml", ".github/workflows/tests.yml"}
    assert modules | tests | project | {"navrl/py.typed"} <= names


def test_installed_command_finds_conf(built, tmp_path):
    """Unpacked alone, away from the clone: what is found can only come from the wheel."""
    with zipfile.ZipFile(built[0]) as archive:
        archive.extractall(tmp_path / "site")
    code = (
        "import sys; sys.path.insert(0, 'site'); import navrl; "
        "assert 'site' in navrl.__file__, navrl.__file__; "
        "from navrl.cli.train import main; main()"
    )
    shown = run(sys.executable, "-c", code, "--cfg", "job", "experiment=paper", cwd=tmp_path)
    assert "navrl.algos.DDPG" in shown
