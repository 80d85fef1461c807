"""Damaged, missing and half-written files of a checkpoint are named, and nothing else is lost."""

import os
import resource
import shutil
from contextlib import contextmanager

import pytest
import torch
from tensordict import TensorDict

from navrl.training import CheckpointError, CheckpointStore, MetricsLog, Progress, Replay
from navrl.training.checkpoint import resumable


def steps(count, size=1):
    flags = torch.zeros(count, 1, dtype=torch.bool)
    following = {"reward": torch.rand(count, 1), "done": flags, "terminated": flags.clone()}
    values = {"x": torch.rand(count, size), "action": torch.rand(count, 2)}
    return TensorDict(
        {**values, "next": TensorDict({**following, "x": values["x"]}, [count])}, [count]
    )


def flipped(content, position):
    return content[:position] + bytes([content[position] ^ 4]) + content[position + 1 :]


@contextmanager
def largest_file(size):
    """Let the operating system refuse writes beyond ``size`` bytes, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_any_flipped_bit_in_the_state_is_detected(tmp_path):
    store = CheckpointStore(tmp_path)
    store.save({"x": torch.arange(50.0), "name": "value"})
    file = tmp_path / "state.pt"
    whole = file.read_bytes()
    for position in {*range(0, len(whole), 23), *range(len(whole) - 70, len(whole))}:
        file.write_bytes(flipped(whole, position))
        with pytest.raises(CheckpointError, match=r"state\.pt: damaged.*start a new run"):
            store.load()
    for end in (0, 10, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:end])
        with pytest.raises(CheckpointError, match=r"state\.pt: damaged"):
            store.load()
    file.write_bytes(whole)
    assert torch.equal(store.load()["x"], torch.arange(50.0))


def test_older_state_without_a_digest_is_read(tmp_path):
    store = CheckpointStore(tmp_path)
    torch.save({"x": 1}, tmp_path / "state.pt")
    assert store.load() == {"x": 1}
    (tmp_path / "state.pt").write_bytes((tmp_path / "state.pt").read_bytes()[:-1])
    with pytest.raises(CheckpointError, match="damaged"):
        store.load()


def test_any_flipped_bit_in_the_journal_is_detected(tmp_path):
    replay = Replay(["x"], capacity=10, batch_size=4)
    replay.extend(steps(5))
    state = replay.save(tmp_path)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    for position in range(0, len(whole), 7):
        file.write_bytes(flipped(whole, position))
        with pytest.raises(CheckpointError, match=r"chunk_0+\.safetensors: damaged"):
            Replay(["x"], capacity=10, batch_size=4).load(tmp_path, state)
    file.write_bytes(whole[:-1])
    state["chunks"] = [chunk[:2] for chunk in state["chunks"]]  # as older journals list them
    with pytest.raises(CheckpointError, match=r"chunk_0+\.safetensors: damaged"):
        Replay(["x"], capacity=10, batch_size=4).load(tmp_path, state)


def test_journal_load_deletes_unlisted_files(tmp_path):
    replay = Replay(["x"], capacity=10, batch_size=4)
    replay.extend(steps(5))
    state = replay.save(tmp_path)
    replay.extend(steps(3))
    replay.save(tmp_path)  # killed before the state file of this one
    (tmp_path / ".chunk_000000000008.0a1b.safetensors").write_bytes(b"half")
    Replay(["x"], capacity=10, batch_size=4).load(tmp_path, state)
    assert [file.name for file in tmp_path.iterdir()] == ["chunk_000000000000.safetensors"]


def test_files_and_folders_are_synchronized(tmp_path, monkeypatch):
    synchronized, fsync = [], os.fsync

    def remembered(descriptor):
        synchronized.append(os.readlink(f"/proc/self/fd/{descriptor}"))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", remembered)
    store = CheckpointStore(tmp_path)
    replay = Replay(["x"], capacity=10, batch_size=4)
    replay.extend(steps(5))
    state = replay.save(store.journal)
    assert ".chunk_" in synchronized[0] and synchronized[1] == str(store.journal)
    store.save({"replay": state})
    assert ".state." in synchronized[2] and synchronized[3] == str(tmp_path)


def test_full_disk_keeps_the_last_checkpoint(tmp_path):
    store, replay = CheckpointStore(tmp_path), Replay(["x"], capacity=3000, batch_size=4)
    replay.extend(steps(5))
    store.save({"replay": replay.save(store.journal)})
    before = sorted(tmp_path.rglob("*"))
    replay.extend(steps(2000))
    with largest_file(4096):
        with pytest.raises(OSError, match=r"chunk_0+5\.safetensors.*File too large"):
            replay.save(store.journal)
        with pytest.raises(OSError, match=r"File too large.*state\.pt"):
            store.save({"x": torch.zeros(5000)})
    assert sorted(tmp_path.rglob("*")) == before
    copy = Replay(["x"], capacity=3000, batch_size=4)
    copy.load(store.journal, store.load()["replay"])
    assert len(copy) == 5
    store.save({"replay": replay.save(store.journal)})  # once there is space again
    copy = Replay(["x"], capacity=3000, batch_size=4)
    copy.load(store.journal, store.load()["replay"])
    assert len(copy) == 2005


def test_system_error_states_how_to_continue(tmp_path):
    def write():
        with resumable(tmp_path), open("/dev/full", "w") as full:
            full.write("x")

    with pytest.raises(OSError, match="No space") as caught:
        write()
    assert "saved before is complete" in str(caught.value)
    assert f"resume={tmp_path}" in str(caught.value)


def test_full_disk_at_a_row_of_the_log_names_the_file(tmp_path):
    log = MetricsLog(tmp_path)
    log.log(10, 1, {"a": 1.0})
    size = (tmp_path / "metrics.csv").stat().st_size
    with largest_file(size + 2), pytest.raises(OSError, match=r"File too large.*metrics\.csv"):
        log.log(20, 2, {"a": 2.0})
    log = MetricsLog(tmp_path, resume_frames=20)  # the row was cut off
    log.log(20, 2, {"a": 3.0})
    assert (tmp_path / "metrics.csv").read_text().split() == [
        "frames,updates,a",
        "10,1,1",
        "20,2,3",
    ]


def test_log_retains_only_rows_of_the_checkpoint(tmp_path):
    log = MetricsLog(tmp_path)
    for value in (1.0, 2.0, 3.0):
        log.log(10, 1, {"a": value})
    log = MetricsLog(tmp_path, resume_frames=10, resume_rows=2)
    assert log.num_rows == 2
    log.log(20, 2, {"a": 4.0})
    assert log.num_rows == 3
    assert (tmp_path / "metrics.csv").read_text().split()[1:] == ["10,1,1", "10,1,2", "20,2,4"]


@pytest.mark.parametrize(
    "text",
    [
        "frames;updates\n10;1\n",  # saved by a spreadsheet
        "\ufeffframes,updates\n10,1\n",
        "frames,updates\n10,1,7\n",
        "frames,updates\n1e1,1\n",
        "frames,updates\n,1\n",
    ],
)
def test_damaged_log_is_named(tmp_path, text):
    (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(ValueError, match=r"metrics\.csv: damaged, each row must have"):
        MetricsLog(tmp_path, resume_frames=10)
    assert (tmp_path / "metrics.csv").read_text() == text


@pytest.mark.parametrize("left", ["journal", "log"])
def test_run_with_missing_state_does_not_restart(tmp_path, left):
    store, replay = (
        CheckpointStore(tmp_path / "checkpoint"),
        Replay(["x"], capacity=9, batch_size=4),
    )
    log = tmp_path / "metrics.csv"
    store.check_new(log)
    replay.extend(steps(5))
    store.save({"replay": replay.save(store.journal)})
    if left == "log":
        log.write_text("frames,updates\n")
        shutil.rmtree(store.journal)
    store.check_new(log)
    (store.folder / "state.pt").unlink()
    with pytest.raises(CheckpointError, match=r"state\.pt: missing.*put it back.*delete"):
        store.check_new(log)


def test_half_written_state_is_removed_at_a_load(tmp_path):
    store = CheckpointStore(tmp_path)
    store.save({"x": 1})
    (tmp_path / ".state.0a1b2c3d.tmp").write_bytes(b"half")
    assert store.load() == {"x": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["state.pt"]


@pytest.mark.parametrize(
    ("saved", "best"),
    [
        ({"frames": 11, "success_rate": 0.5, "curriculum_level": 1}, (1, 0.5)),
        ({"frames": 11, "success_rate": 0.5}, (2, 0.5)),  # older: at least the checkpoint's level
        ({"frames": 9, "success_rate": 0.5, "curriculum_level": 1}, (0, 0.25)),
        (None, (-1, -1.0)),
    ],
)
def test_best_score_is_of_the_later_saved_policy(saved, best):
    progress = Progress(frames=10, best_level=0, best_success_rate=0.25)
    progress.restore_best(saved, level=2)
    assert (progress.best_level, progress.best_success_rate) == best
