"""Replay, journal, curriculum, schedule, checkpoint store and log, each alone."""

import csv

import pytest
import torch
from tensordict import TensorDict

from navrl.training import (
    CheckpointError,
    CheckpointStore,
    Curriculum,
    MetricsLog,
    Progress,
    Replay,
    Schedule,
)


def transitions(start: int, count: int) -> TensorDict:
    value = torch.arange(start, start + count).float().unsqueeze(-1) / 1000
    flags = torch.zeros(count, 1, dtype=torch.bool)
    following = {"x": value + 0.5, "reward": value, "done": flags, "terminated": flags.clone()}
    return TensorDict(
        {
            "x": value,
            "ranges": torch.zeros(count, 1440),
            "action": value.expand(-1, 2).clone(),
            "next": TensorDict(following, [count]),
        },
        [count],
    )


def test_replay_stores_only_network_inputs():
    replay = Replay(["x"], capacity=100, batch_size=16)
    replay.extend(transitions(0, 50))
    batch = replay.sample()
    assert set(batch.keys(True, True)) == {
        "x",
        "action",
        ("next", "x"),
        ("next", "reward"),
        ("next", "done"),
        ("next", "terminated"),
    }
    assert batch["x"].dtype == torch.float32 and batch["next", "done"].dtype == torch.bool
    torch.testing.assert_close(batch["next", "x"], batch["x"] + 0.5, atol=1e-3, rtol=0)


@pytest.mark.parametrize("storage", ["float16", "float32"])
def test_journal_restores_every_row_at_its_place(tmp_path, storage):
    original = Replay(["x"], capacity=64, batch_size=32, storage=storage)
    for k in range(5):  # 100 rows into 64 places: wraps
        original.extend(transitions(20 * k, 20))
        state = original.save(tmp_path)
        original.prune(tmp_path)
    copy = Replay(["x"], capacity=64, batch_size=32, storage=storage)
    copy.load(tmp_path, state)
    for replay in (original, copy):
        replay.extend(transitions(100, 7))
    torch.manual_seed(3)
    expected = [original.sample() for _ in range(5)]
    torch.manual_seed(3)
    for batch in expected:
        assert (copy.sample() == batch).all()
    assert len(copy) == 64


def test_journal_drops_overwritten_rows(tmp_path):
    replay = Replay(["x"], capacity=10, batch_size=4)
    for k in range(6):
        replay.extend(transitions(5 * k, 5))
        replay.save(tmp_path)
        replay.prune(tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def test_journal_names_missing_files(tmp_path):
    replay = Replay(["x"], capacity=10, batch_size=4)
    replay.extend(transitions(0, 5))
    state = replay.save(tmp_path)
    next(tmp_path.iterdir()).unlink()
    with pytest.raises(CheckpointError, match=r"chunk_000000000000.*missing"):
        Replay(["x"], capacity=10, batch_size=4).load(tmp_path, state)


def test_curriculum_level_rises_only_above_the_threshold():
    curriculum = Curriculum((2, 4, 8), threshold=0.7)
    assert not curriculum.report(0.7) and curriculum.max_dynamic == 2
    assert curriculum.report(0.71) and curriculum.max_dynamic == 4
    assert not curriculum.report(0.0) and curriculum.max_dynamic == 4
    assert curriculum.report(0.9) and curriculum.max_dynamic == 8
    assert not curriculum.report(1.0) and curriculum.max_dynamic == 8


@pytest.mark.parametrize("options", [{"levels": (4, 2)}, {"threshold": 70}, {"start": 3}])
def test_bad_curricula_are_named(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        Curriculum(**options)


def test_bad_schedule_is_named():
    with pytest.raises(ValueError, match="frames_per_update=0"):
        Schedule(frames_per_update=0)


def test_schedule_follows_frames_or_seconds():
    by_frames, by_both = Schedule(total_frames=100), Schedule(total_frames=100, total_seconds=60.0)
    slow = Progress(frames=20, seconds=45.0)
    assert by_frames.share_done(slow) == 0.2 and by_frames.scheduled_frames(slow) == 20
    assert by_both.share_done(slow) == 0.75 and by_both.scheduled_frames(slow) == 75
    fast = Progress(frames=90, seconds=6.0)
    assert by_both.share_done(fast) == 0.9 and by_both.scheduled_frames(fast) == 90
    with pytest.raises(ValueError, match="total_seconds=0"):
        Schedule(total_seconds=0)


def test_checkpoint_is_valid_beside_a_partial_successor(tmp_path):
    store = CheckpointStore(tmp_path)
    with pytest.raises(FileNotFoundError, match="no checkpoint"):
        store.load()
    store.save({"x": torch.ones(2)})
    (tmp_path / "state.tmp").write_bytes(b"half")
    assert torch.equal(store.load()["x"], torch.ones(2))


def test_log_adds_columns_and_drops_repeated_rows(tmp_path):
    log = MetricsLog(tmp_path)
    log.log(10, 1, {"a": 1.0})
    log.log(20, 2, {"a": 2.0, "b": 3.0})
    log.log(30, 3, {"a": 4.0})
    log = MetricsLog(tmp_path, resume_frames=20)
    log.log(30, 3, {"b": 5.0})
    rows = list(csv.DictReader((tmp_path / "metrics.csv").open()))
    assert [row["frames"] for row in rows] == ["10", "20", "30"]
    assert rows[0]["b"] == "" and rows[2] == {"frames": "30", "updates": "3", "a": "", "b": "5"}
