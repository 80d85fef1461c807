"""The notebooks of the documentation are stored without outputs and run from top to bottom."""

import json
import re

import pytest
from nightly import mostly
from pages import ROOT

FOLDER = ROOT / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def cells(path, kind):
    found = json.loads(path.read_text())["cells"]
    return ["".join(cell["source"]) for cell in found if cell["cell_type"] == kind]


def named(path):
    return path.stem


def test_there_are_four_notebooks():
    assert [path.stem for path in NOTEBOOKS] == ["evaluate", "look", "train", "transforms"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_notebook_is_stored_without_outputs(path):
    notebook = json.loads(path.read_text())
    assert notebook["metadata"]["kernelspec"]["name"] == "python3"
    for cell in notebook["cells"]:
        assert not cell.get("outputs") and cell.get("execution_count") is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_notebook_opens_with_its_purpose(path):
    title, _, purpose = cells(path, "markdown")[0].partition("\n\n")
    assert title.startswith("# ") and purpose.startswith("After this notebook you can ")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=named)
def test_links_of_a_notebook_exist(path):
    links = re.findall(r"\]\(([^)#]+)", "\n".join(cells(path, "markdown")))
    assert links
    for link in links:
        assert (FOLDER / link).is_file(), link


@pytest.mark.parametrize("path", mostly(NOTEBOOKS, [FOLDER / "transforms.ipynb"]), ids=named)
def test_notebook_runs(path, tmp_path, monkeypatch):
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    notebook = nbformat.read(path, 4)
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=where).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    errors = [output["text"] for output in outputs if output.get("name") == "stderr"]
    lines = [line for text in errors for line in text.splitlines() if line.strip()]
    usual = r"compiling \w+ once|.*check_env_specs succeeded"  # of the kernels; TorchRL's log
    assert all(re.match(usual, line) for line in lines), lines
    if path.stem == "evaluate":
        (table,) = (o["data"]["text/markdown"] for o in outputs if "text/markdown" in str(o))
        assert re.search(r"^\| `?paper`? +\| 20 \|", table, re.M) and "StopAndTurn" in table
    else:
        assert any("image/png" in output.get("data", {}) for output in outputs)
