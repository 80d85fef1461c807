"""The documentation site builds without a warning, and its reference has every public name."""

import html
import importlib
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from navrl import keys
from navrl.config import compose
from navrl.factory.environment import make_training_env

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "docs" / "api"
PACKAGES = [
    *("transforms", "networks", "algos", "training", "sim", "envs", "worlds", "worlds.cards"),
    *("evaluation", "evaluation.metrics", "policies", "policies.classical", "deploy"),
    *("viz", "viz.report", "factory", "jobs"),
]


@pytest.fixture(scope="module")
def site(once):
    for needed in ("mkdocs", "material", "mkdocstrings", "mkdocstrings_handlers", "mkdocs_jupyter"):
        if importlib.util.find_spec(needed) is None:
            pytest.skip(f"the site needs {needed}: pip install -e '.[test,docs]'")
    return once("site", build)


def build(folder):
    result = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stderr[-3000:]


def words(page: Path) -> str:
    """The text that a reader of the page sees, without spaces at which a line may break."""
    article = re.search(r"<article.*?</article", page.read_text(), re.S)[0]
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", "", article)))


def test_every_page_is_in_the_site(site):
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix("")
        assert (site / name / "index.html").exists() or str(name) == "index", page


@pytest.mark.parametrize("package", PACKAGES)
def test_the_reference_has_an_entry_for_each_public_name(site, package):
    module = importlib.import_module(f"navrl.{package}")
    pages = "".join(page.read_text() for page in site.glob("api/*/index.html"))
    for name in module.__all__:
        home = getattr(getattr(module, name), "__module__", module.__name__)
        ids = (f'id="{module.__name__}.{name}"', f'id="{home}.{name}"')
        assert any(entry in pages for entry in ids), f"{package}.{name} has no entry in docs/api"


def test_the_reference_shows_signatures_shapes_and_units(site):
    transforms = words(site / "api" / "transforms" / "index.html")
    assert (
        'MinPool( group_size: int | None = 8, max_range: float = 3.5, bearing: Bearing = "bin"'
        in transforms
    )
    assert "Pooled ranges [*B, N] m, points [*B, N, 2] m in the robot frame" in transforms
    assert "m, arc length of the robot's projection on the path" in words(
        site / "api" / "simulation" / "index.html"
    )
    for page in site.glob("api/*/index.html"):
        assert not re.search(r":(func|class|meth|mod|attr|data):", words(page)), page


def test_every_page_is_reachable():
    """Without mkdocs at hand too: a page that the menu leaves out is found by nobody."""
    menu = (ROOT / "mkdocs.yml").read_text()
    for page in (ROOT / "docs").rglob("*.md"):
        assert f": {page.relative_to(ROOT / 'docs')}\n" in menu, page
    assert "strict: true" in menu


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.stem)
def test_page_opens_with_its_purpose(page):
    title, purpose = page.read_text().split("\n\n")[:2]
    assert title.startswith("# ") and "\n" not in title
    assert re.match(r"After this page [a-z]", purpose) and len(purpose) < 300


def test_home_page_has_a_path_for_each_reader():
    text = (ROOT / "docs" / "index.md").read_text()
    for reader in ("Researcher", "Roboticist", "Engineer"):
        part = re.split(r"^## ", text.partition(f"## {reader}: ")[2], flags=re.M)[0]
        steps = re.findall(r"^(\d)\. \[", part, re.M)
        assert [int(step) for step in steps] == list(range(1, len(steps) + 1)) and len(steps) >= 5
        assert "notebooks/" in part, "each path has a notebook"


def test_links_of_notebooks_lead_to_pages(site):
    for folder in (site / "notebooks").iterdir():
        page = (folder / "index.html").read_text()
        article = re.search(r"<article.*?</article", page, re.S)[0]
        links = re.findall(r'href="(\.\./[^"#]*)', article)
        assert links or folder.name == "train"
        for link in links:
            assert not link.endswith((".md", ".ipynb")) and (folder / link).exists(), link


def test_site_has_search_and_versions(site):
    assert (site / "search" / "search_index.json").stat().st_size > 100_000
    assert '"version": {"provider": "mike"}' in (site / "index.html").read_text()


def test_features_page_explains_each_lack():
    page = (ROOT / "docs" / "features.md").read_text()
    table, _, reasons = page.partition("## What navrl lacks")
    rows = re.findall(r"^\| ([^|]+) \| ([^|]+) \|.*\|$", table, re.M)
    lacking = {name for name, own in rows if own == "no"}
    assert lacking == set(
        re.findall(r"^\| ([^|]+) \| [A-Z]", reasons.partition("## Sources")[0], re.M)
    )
    assert len(rows) > 25 and len(lacking) < 10
    bundles = len(list((ROOT / "navrl" / "policies" / "zoo").iterdir()))
    assert f"| trained policies | {bundles} in the package |" in page


def test_pipeline_page_lists_folders_keys_and_shapes():
    page = (ROOT / "docs" / "pipeline.md").read_text()
    folders = {folder.parent.name for folder in (ROOT / "navrl").glob("*/__init__.py")}
    assert all(f"`{folder}`" in page for folder in folders)
    names = {value for name, value in vars(keys).items() if name.isupper()}
    rows = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \| (.*?) \| ", page.partition("## Keys")[2], re.M)
    shapes = {}
    for listed, shape in rows:
        found = re.findall(r"`\[(.*?)\]`", shape)
        for k, key in enumerate(re.findall(r"`(\w+)`", listed)):
            shapes[key] = found[k if len(found) > 1 else 0] if found else None
    assert shapes.keys() == names
    cfg = compose("train", ["experiment=paper", "pool_size=2", "num_threads=1"])
    env = make_training_env(cfg, seed=0, num_worlds=2)
    step = env.rand_step(env.reset())["next"]
    seen = {key: list(step[key].shape) for key in names & set(step.keys()) if shapes[key]}
    assert len(seen) >= 19
    for key, shape in seen.items():
        assert [2, *map(int, shapes[key].split(", ")[1:])] == shape, key
