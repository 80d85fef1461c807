"""Compiled kernels on disk: damaged ones are compiled again, foreign ones never loaded."""

import errno
import os
import signal
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from navrl.ops.kernels import cache, compiler


def doubled(folder, monkeypatch):
    """Compile or load a kernel as a new process would, and run it."""
    monkeypatch.setattr(compiler, "cache_directory", lambda: str(folder))

    def double(rows, values):
        for index in range(rows[0], rows[1]):
            values[index] *= 2

    values = np.ones(3)
    compiler.kernel(double)(values)
    return values.tolist()


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.999])
def test_truncated_kernel_file_is_rebuilt(tmp_path, monkeypatch, caplog, share):
    assert doubled(tmp_path, monkeypatch) == [2, 2, 2]
    (file,) = tmp_path.rglob("*.nbc")
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    caplog.clear()
    assert doubled(tmp_path, monkeypatch) == [2, 2, 2]
    assert file.name in caplog.text and "compiled again" in caplog.text
    caplog.clear()
    assert doubled(tmp_path, monkeypatch) == [2, 2, 2]
    assert not caplog.text


def test_corrupt_kernel_file_is_not_executed(tmp_path, monkeypatch, caplog):
    doubled(tmp_path, monkeypatch)
    (file,) = tmp_path.rglob("*.nbc")
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(bytes(content))
    assert doubled(tmp_path, monkeypatch) == [2, 2, 2]
    assert "damaged" in caplog.text


def test_kernel_runs_without_a_writable_cache(tmp_path, monkeypatch, caplog):
    def full(file):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(file))

    monkeypatch.setattr(cache, "replacing", full)
    assert doubled(tmp_path, monkeypatch) == [2, 2, 2]
    assert "not saved" in caplog.text and "no space left" in caplog.text


def compile_in_child(folder, monkeypatch, start, compiled):
    """Fork a process that compiles the kernel and notes it, slowly enough to be met."""
    child = os.fork()
    if child:
        return child
    save = cache.KernelFiles.save

    def slow(files, key, data):
        compiled.write(f"{os.getpid()}\n")
        compiled.flush()
        time.sleep(0.5)
        save(files, key, data)

    monkeypatch.setattr(cache.KernelFiles, "save", slow)
    while time.monotonic() < start:
        time.sleep(0.001)
    os._exit(doubled(folder, monkeypatch) != [2, 2, 2])


def test_processes_that_start_at_once_compile_once(tmp_path, monkeypatch):
    start = time.monotonic() + 0.2
    with (tmp_path / "compiled").open("a") as compiled:
        folder = tmp_path / "kernels"
        children = [compile_in_child(folder, monkeypatch, start, compiled) for _ in range(3)]
        assert [os.waitpid(child, 0)[1] for child in children] == [0, 0, 0]
    assert len((tmp_path / "compiled").read_text().splitlines()) == 1


def test_a_process_killed_while_compiling_leaves_no_lock(tmp_path, monkeypatch):
    child = os.fork()
    if child == 0:
        monkeypatch.setattr(
            cache.KernelFiles, "save", lambda *_: os.kill(os.getpid(), signal.SIGKILL)
        )
        doubled(tmp_path, monkeypatch)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
    assert doubled(tmp_path, monkeypatch) == [2, 2, 2]


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """A machine whose home cannot be written: only the shared temporary folder is left."""
    (tmp_path / "home").write_text("no folder")
    (tmp_path / "shared").mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "shared"))
    return tmp_path / "shared"


def chosen():
    return Path(cache.cache_directory.__wrapped__())


def test_shared_cache_folder_is_private_to_the_user(shared):
    first = chosen()
    assert first == chosen() and first.parent.parent == shared
    assert first.stat().st_mode & 0o077 == first.parent.stat().st_mode & 0o077 == 0


def test_a_folder_that_others_can_write_is_not_used(shared, caplog):
    folder = chosen().parent
    folder.chmod(0o777)
    found = chosen()
    assert folder not in found.parents and str(folder) in caplog.text


def test_a_link_is_not_used(shared, tmp_path):
    folder = chosen().parent
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    assert folder not in chosen().parents


def test_a_folder_of_another_user_is_not_used(shared, monkeypatch):
    folder = chosen().parent
    real = os.lstat

    def of_another(path, **options):
        status = list(real(path, **options))
        status[4] = 12345 if Path(path) == folder else status[4]
        return os.stat_result(status)

    monkeypatch.setattr(os, "lstat", of_another)
    monkeypatch.setattr(Path, "lstat", lambda self: of_another(self))
    assert folder not in chosen().parents
