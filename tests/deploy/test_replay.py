"""Replay of a log through a policy."""

import csv
import json
import math

import numpy as np
import pytest
from pages import exit_status

from navrl.cli.command import _with_key
from navrl.config import compose
from navrl.deploy import PolicyRunner, adapt_scan, load_scanner
from navrl.deploy.recorded_paths import GoalPath, TrajectoryPaths
from navrl.evaluation.recording import Recording
from navrl.jobs.replaying import run_replay
from navrl.policies import ZOO

made = pytest.importorskip("made_bags", reason="needs the extra bags", exc_type=ImportError)
FILES = ("commands.csv", "commands.png", "episode.npz", "replay.json")


def replayed(folder, bag, *overrides):
    """Return the summary and the rows of the table."""
    cfg = compose("replay", [f"bag='{bag}'", "policy=paper", *overrides])
    summary = run_replay(cfg, folder)
    with (folder / "commands.csv").open() as stream:
        return summary, list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return made.driven(tmp_path_factory.mktemp("bag"), "mcap", turn_rate=0.0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, bag):
    folder = tmp_path_factory.mktemp("replay")
    return folder, *replayed(folder, bag)


def numbers(rows, name, only=lambda row: True):
    return np.array([float(row[name]) for row in rows if only(row)])


def is_decided(row):
    return row["decided"] == "1"


def test_summary_has_states_decisions_and_sources(whole):
    _, summary, rows = whole
    assert summary == json.loads((whole[0] / "replay.json").read_text())
    assert summary["states_s"] == {"drive": pytest.approx(0.05 * len(rows))}
    assert summary["decisions"] == 20 and summary["history_restarts"] == 0
    assert (summary["path"], summary["pose_source"]) == ("/plan", "pose")
    assert summary["mount_source"] == "tf base_link <- laser"
    assert summary["alignment"]["pairs"] == summary["alignment"]["moving"] == 19
    assert summary["rejected"] == {}


def test_table_has_commands_beside_recorded_ones(whole):
    _, summary, rows = whole
    assert len(rows) == 80 and numbers(rows, "time_s")[:3] == pytest.approx([0.0, 0.05, 0.1])
    assert set(numbers(rows, "recorded_v")) == set(numbers(rows, "measured_v")) == {0.5}
    assert numbers(rows, "x") == pytest.approx(0.025 * np.arange(80), abs=1e-3)
    v = numbers(rows, "v", is_decided) - 0.5
    assert summary["difference"]["v_mps"] == pytest.approx(np.sqrt(np.mean(v**2)), abs=1e-3)
    errors = [float(row["icp_error_m"]) for row in rows if row["icp_error_m"]]
    share = np.mean([error <= 0.1 for error in errors])
    assert summary["alignment"]["moving_within"] == pytest.approx(share, abs=1e-3)


def test_first_command_is_that_of_the_runner(whole, bag):
    """Without history and at the first pose: the same scan gives the same command."""
    bearings = -math.pi + 2 * math.pi / 360 * np.arange(360)
    runner = PolicyRunner.from_bundle(ZOO / "paper")
    scanner = load_scanner(angle_min=-math.pi, range_max=12.0)
    ranges = made.room((0.0, 0.0, 0.0), bearings).astype(np.float32)
    scan = adapt_scan(ranges, scanner, runner.lidar).ranges
    path = [(0.0, 0.0), (5.0, 0.0)]
    expected = runner.act(scan, (0.0, 0.0, 0.0), path, (0.5, 0.0))
    row = whole[2][0]
    assert (float(row["v"]), float(row["w"])) == pytest.approx(expected.tolist(), abs=1e-3)


def test_recording_has_a_row_per_decision(whole):
    folder, _, rows = whole
    recording = Recording.load(folder / "episode.npz")
    assert recording.outcome == "replay" and recording.num_steps == 20
    assert recording.time_step_s == pytest.approx(0.2)
    assert recording.ranges.shape == (21, 1440) and recording.tagd.shape == (21, 30, 4)
    assert recording.pose[:-1, 0] == pytest.approx(numbers(rows, "x", is_decided), abs=1e-3)
    assert recording.action[:, 0] == pytest.approx(numbers(rows, "v", is_decided), abs=1e-4)
    assert recording.spatial_attention.shape == (20, 30)
    assert recording.goal == pytest.approx([5.0, 0.0])


def test_repeated_replay_writes_the_same_bytes(whole, bag, tmp_path):
    for name in (*FILES, "config.yaml"):
        if name != "replay.json":  # killed before the last file
            (tmp_path / name).write_bytes((whole[0] / name).read_bytes()[:100])
    (tmp_path / "config.yaml").write_bytes((whole[0] / "config.yaml").read_bytes())
    replayed(tmp_path, bag)
    for name in FILES:
        assert (tmp_path / name).read_bytes() == (whole[0] / name).read_bytes(), name


def test_folder_of_another_replay_is_an_error(whole, bag):
    with pytest.raises(ValueError, match="has a run of another configuration"):
        replayed(whole[0], bag, "limits.speed_scale=0.3")


def test_backward_mount_gives_the_same_commands(whole, tmp_path):
    """An A1 that is mounted backwards, by tf or by the option."""
    mount = (0.0, 0.0, math.pi)
    turned = made.driven(tmp_path, turn_rate=0.0, mount=mount)
    _, rows = replayed(tmp_path / "tf", turned)
    assert numbers(rows, "v") == pytest.approx(numbers(whole[2], "v"), abs=0.02)
    wrong, _ = replayed(tmp_path / "wrong", turned, "mount=[0.0,0.0,0.0]")
    assert wrong["mount_source"] == "the option mount"
    assert wrong["alignment"]["moving_within"] < 0.1  # the scans move the other way


def test_goal_is_a_straight_path(bag, tmp_path):
    summary, rows = replayed(tmp_path, bag, "goal=[1.0,0.0]", "duration_s=3.0")
    assert summary["path"] == "straight to [1.0, 0.0]"
    assert float(rows[5]["goal_distance_m"]) == pytest.approx(1.0 - 0.125, abs=1e-3)
    arrived = [row for row in rows if row["state"] == "at_goal"]
    assert arrived and {row["v"] for row in arrived} == {"0"}
    assert float(arrived[0]["time_s"]) == pytest.approx(1.6, abs=0.11)  # at 0.8 m


def test_gap_of_a_log_is_stale_and_restarts_the_history(tmp_path):
    file = made.carmen(tmp_path / "a.log", num_scans=30)
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:10], *lines[18:]]) + "\n")
    summary, rows = replayed(tmp_path / "out", file)
    assert summary["path"] == "trajectory" and summary["mount"] == pytest.approx(
        [0.1, 0.0, 0.0], abs=1e-6
    )
    assert summary["states_s"]["stale_scan"] == pytest.approx(1.3, abs=0.11)
    assert summary["history_restarts"] == 1
    stale = [row for row in rows if row["state"] == "stale_scan"]
    assert {row["v"] for row in stale} == {"0"} and "old" in stale[0]["reason"]


def test_invalid_inputs_are_counted(tmp_path):
    bag = made.driven(tmp_path, duration_s=1.0, scan={"angle_increment": 0.5})
    summary, _ = replayed(tmp_path / "out", bag)
    ((reason, count),) = summary["rejected"].items()
    assert "angle_increment" in reason and count == 10
    assert summary["states_s"] == {"stale_scan": pytest.approx(1.0, abs=0.06)}
    assert not (tmp_path / "out" / "episode.npz").exists()


def test_clock_of_the_stamps_is_an_option(tmp_path):
    bag = made.driven(tmp_path, duration_s=1.0, scan={"late": 2.0}, turn_rate=0.0)
    late, _ = replayed(tmp_path / "late", bag)
    assert "drive" not in late["states_s"]
    timely, _ = replayed(tmp_path / "timely", bag, "clock=stamp")
    assert timely["decisions"] > 0


@pytest.mark.parametrize(
    ("override", "reason"),
    [
        ("policy=dwa", "policy=dwa: must be a bundle"),
        ("path=plan", "path=plan: must be one of auto, topic, trajectory"),
        ("tick_s=0.0", "tick_s=0.0: must be positive"),
        ("clock=wall", "clock=wall: must be received or stamp"),
        ("goal=[1.0]", r"goal=\[1.0\]: must be 2 finite numbers"),
        ("scan_topic=/front", "scan_topic=/front: must be one of /scan"),
        ("pose_source=gps", "pose_source=gps: must be one of auto, pose, tf"),
        ("mount=[0.0,0.0]", "mount="),
        ("goal=[a,0]", r"goal=\['a', 0\]: must be 2 finite numbers"),
        ("goal=[.nan,0]", "goal=.*: must be 2 finite numbers"),
        ("goal=3", "goal=3.*: must be 2 finite numbers"),
        ("mount=[0,0,pi]", r"mount=\[0, 0, 'pi'\]: must be three finite numbers"),
        ("mount=3", "mount=3.*: must be three finite numbers"),
        ("start_s=-1.0", "start_s=-1.0: must be"),
        ("start_s=100", r"start_s=100: must be below \d+\.\d s, the length of the log"),
    ],
)
def test_bad_option_is_an_error_that_names_it(override, reason, bag, tmp_path):
    with pytest.raises(ValueError, match=reason):
        replayed(tmp_path, bag, override)


def test_command_takes_the_bag_as_its_first_word(bag, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    odd = tmp_path / "it's (1).mcap"
    odd.write_bytes(next(bag.glob("*.mcap")).read_bytes())
    words = f'navrl-replay "{odd}" policy=paper duration_s=0.3 hydra.run.dir=out'
    assert exit_status(words) == 0
    assert (tmp_path / "out" / "commands.png").stat().st_size > 10_000
    assert _with_key(["policy=paper", "bag=a"], "bag") == ["policy=paper", "bag=a"]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("absent.bag", "absent.bag: no such file or folder"),
        (
            "absent.bag policy=papre",
            "policy=papre: no such bundle or controller; did you mean paper",
        ),
        ("absent.bag tick=0.1", "tick"),
        ("absent.bag +strict=true", "strict=True: no effect, navrl-replay has no such key"),
        ("absent.bag tick_s=fast", "tick_s=fast: must be float"),
    ],
)
def test_command_reports_mistakes_in_one_line(words, reason, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert exit_status(f"navrl-replay {words}") == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("navrl: ") and reason in line


# --- paths ---------------------------------------------------------------------------------------


def test_trajectory_path_ends_at_the_farthest_point_ahead():
    there = np.stack([np.linspace(0.0, 3.0, 31), np.zeros(31)], axis=1)
    points = np.concatenate([there, there[-2::-1]])
    paths = TrajectoryPaths(np.arange(len(points), dtype=float), points, horizon_m=5.0)
    assert paths.path_at(0.0, None)[-1] == pytest.approx([3.0, 0.0])
    assert paths.path_at(0.5, None) is None  # once per second
    assert paths.path_at(45.0, None)[[0, -1], 0] == pytest.approx([1.5, 0.0])


def test_standing_robot_gives_no_noise_of_points():
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(0.0, 0.005, (200, 2)), [[1.0, 0.0], [2.0, 0.0]]])
    path = TrajectoryPaths(np.arange(202.0), points).path_at(100.0, None)
    assert len(path) == 3


def test_goal_path_starts_at_the_first_pose():
    plan = GoalPath((4.0, 1.0))
    assert plan.path_at(0.0, None) is None
    assert plan.path_at(0.1, np.array([1.0, 2.0, 0.3])).tolist() == [[1.0, 2.0], [4.0, 1.0]]
    assert plan.path_at(0.2, np.zeros(3)) is None
