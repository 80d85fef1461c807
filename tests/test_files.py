"""Atomic writes: the old file or the whole new one, and errors that name the file."""

import csv
import errno
import io
import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from navrl import files
from navrl.config import describe


@pytest.fixture
def full_disk(monkeypatch):
    """Let a write beyond the first 64 bytes of a file find no space, as the system reports it."""

    class FullFile(io.FileIO):
        def write(self, data):
            if self.tell() + len(data) > 64:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(data)

    class RememberingFullFile(files._RememberingFile, FullFile):
        pass

    monkeypatch.setattr(files, "_RememberingFile", RememberingFullFile)


def write_with_torch(file):
    with files.replacing(file) as stream:
        torch.save({"weights": torch.zeros(100_000)}, stream)  # more than a buffer


def write_with_numpy(file):
    with files.replacing(file) as stream:
        np.savez_compressed(stream, values=np.random.default_rng(0).random(1000))


WRITERS = {
    "text": lambda file: files.write_text(file, "new " * 100),
    "json": lambda file: files.write_json(file, list(range(1000))),
    "torch": write_with_torch,
    "numpy": write_with_numpy,
}


@pytest.mark.parametrize("name", WRITERS)
def test_file_is_replaced_without_leftovers(tmp_path, name):
    file = tmp_path / "deep" / "file.any"
    WRITERS[name](file)
    WRITERS[name](file)
    assert file.stat().st_size > 100
    assert os.listdir(file.parent) == ["file.any"]


@pytest.mark.parametrize("name", WRITERS)
def test_full_disk_preserves_and_names_the_old_file(tmp_path, full_disk, name):
    file = tmp_path / "file.any"
    file.write_text("old")
    with pytest.raises(OSError, match="No space left") as error:
        WRITERS[name](file)
    assert error.value.errno == errno.ENOSPC
    assert describe(error.value) == (
        f"{file}: no space left on the disk; free some and run the same command again"
    )
    assert file.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.any"]


def test_any_other_error_preserves_the_old_file(tmp_path):
    file = tmp_path / "file.any"
    file.write_text("old")
    with pytest.raises(TypeError), files.replacing(file) as stream:
        stream.write("no bytes")
    assert file.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.any"]


def test_killed_writer_preserves_the_old_file(tmp_path):
    file = tmp_path / "file.any"
    file.write_text("old")
    code = (
        "import os, signal, sys\n"
        "from navrl.files import replacing\n"
        "with replacing(sys.argv[1]) as stream:\n"
        "    stream.write(b'half of the new')\n"
        "    stream.flush()\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(file)], check=False, timeout=120)
    assert file.read_text() == "old"


def test_links_and_devices_are_preserved(tmp_path):
    file, link = tmp_path / "file.txt", tmp_path / "link.txt"
    link.symlink_to(file)
    files.write_text(link, "text")
    assert link.is_symlink() and file.read_text() == "text"
    device = tmp_path / "null.txt"
    device.symlink_to(os.devnull)
    files.write_text(device, "text")
    assert not os.path.isfile(os.devnull)


def test_permissions_equal_those_of_a_new_file(tmp_path):
    (tmp_path / "usual").write_text("")
    files.write_text(tmp_path / "atomic", "")
    assert (tmp_path / "atomic").stat().st_mode == (tmp_path / "usual").stat().st_mode


@pytest.mark.parametrize(
    ("cell", "shown"),
    [
        ("=1+1", "'=1+1"),
        ("+cmd", "'+cmd"),
        ("-cmd", "'-cmd"),
        ("@SUM(A1)", "'@SUM(A1)"),
        ("\t=1", "'\t=1"),
        ("\r=1", "'\n=1"),
        ("a\r=1", "a\n=1"),
        ("paper", "paper"),
        ("a=b", "a=b"),
        ("-0.500000", "-0.500000"),
        ("+1e-5", "+1e-5"),
        ("-inf", "-inf"),
        (-3, "-3"),
        (-0.25, "-0.25"),
        (None, ""),
    ],
)
def test_csv_cells_are_no_formulas_and_numbers_are_unchanged(cell, shown):
    text = files.csv_text(["a", "b"], [{"a": cell, "b": 1}])
    assert list(csv.reader(io.StringIO(text, newline=""))) == [["a", "b"], [shown, "1"]]


def test_markdown_text_has_no_markup():
    text = files.markdown_text("a|b\n<img src=x> [c](d) `e` *f*")
    assert text == r"a\|b &lt;img src=x> \[c\](d) \`e\` \*f\*"
    assert files.markdown_text("a|`b`\nc", code=True) == r"a\|'b' c"
