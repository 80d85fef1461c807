"""From a bag to a driving robot: an A1 mounted backwards, from the first log to the goal."""

import json
import math
import re

import pytest
from pages import exit_status
from simulated_a1 import STEP_S, SimulatedA1
from test_ros_bridge import odometry, pose, scan
from test_ros_bridge import path as empty_path

from navrl.deploy import Controller, load_scanner
from navrl.deploy.ros_bridge import RosBridge
from navrl.deploy.ros_parameters import PARAMETERS, make_controller
from navrl.policies import ZOO

made = pytest.importorskip("made_bags", reason="needs the extra bags", exc_type=ImportError)
EPISODES = (0, 1, 2)  # of table1; the bag is of the first
WORDS = "policy=paper training_scan=false"


@pytest.fixture(scope="module")
def simulated():
    return SimulatedA1()


@pytest.fixture(scope="module")
def bag(simulated, tmp_path_factory):
    """Return the bag of a first drive, by hand, without a word about the mount in tf."""
    writer = made.Writer(tmp_path_factory.mktemp("bag") / "drive", "mcap")
    hand = Controller.from_bundle(ZOO / "paper", load_scanner("rplidar_a1", mount=simulated.mount))
    now, last = [made.START_S], [(0.0, 0.0)]

    def start(path):
        hand.on_path(path)
        writer.path(now[0], path)

    def decide(pose, ranges):
        now[0] += STEP_S
        writer.odometry(now[0], pose, *last[0])
        writer.located(now[0], pose)
        writer.scan("/scan", now[0], "laser", ranges)
        hand.on_odometry(now[0], pose, last[0])
        hand.on_pose(now[0], pose)
        hand.on_scan(now[0], ranges, duration_s=0.001)
        last[0] = hand.tick(now[0] + 0.002)[:2]
        writer.write("/cmd_vel", writer.twist(*map(float, last[0])), now[0])
        return last[0]

    assert simulated.outcomes(EPISODES[:1], start, decide) == ["success"]
    writer.close()
    return writer.file


def findings(folder, subject):
    rows = json.loads((folder / "doctor.json").read_text())["findings"]
    return [row for row in rows if row["subject"] == subject]


def arrivals(simulated, mount):
    """Return the outcomes of episodes that the node's callbacks drive from messages of topics."""
    mounted = {"policy": "paper", "scanner": "rplidar_a1", "pose_source": "amcl_pose"}
    control = make_controller({**PARAMETERS, **mounted}, mount)
    problems: list[str] = []
    bridge, now = RosBridge(control, "map", problems.append), [made.START_S]

    def start(path):
        now[0] += 100.0
        message = empty_path(length=len(path))
        for each, place in zip(message.poses, path.tolist(), strict=True):
            each.pose = pose(*place, 0.0)
        bridge.on_path(message)

    def decide(place, ranges):
        now[0] += STEP_S
        moved, located = odometry(now[0], v=control.tick(now[0]).v), odometry(now[0])
        moved.pose.pose = located.pose.pose = pose(*place.tolist())
        bridge.on_odometry(moved)
        bridge.on_pose(located)
        bridge.on_scan(scan(now[0], ranges, time_increment=1e-6))
        return control.tick(now[0] + 0.001)[:2]

    outcomes = simulated.outcomes(EPISODES, start, decide)
    assert problems == []
    return outcomes


@pytest.mark.slow
def test_backward_lidar_from_the_bag_to_the_goal(simulated, bag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert exit_status(f"navrl-doctor {bag} {WORDS} hydra.run.dir=a") == 3
    (found,) = findings(tmp_path / "a", "mount")
    mount = re.match(
        r"'mount=\[0,0,(.+?)\]' \(node: -p mount:=\"\[0.000, 0.000, \1\]\"\)", found["do"]
    )
    assert found["level"] == "failure" and mount is not None, found
    given, yaw = mount[0].partition(" (")[0], float(mount[1])
    assert abs(math.remainder(yaw - math.pi, math.tau)) < 0.1

    assert exit_status(f"navrl-doctor {bag} {WORDS} {given} hydra.run.dir=b") == 0
    assert [row["level"] for row in findings(tmp_path / "b", "mount")] == ["ok"]

    replay = f"navrl-replay {bag} policy=paper {given} hydra.run.dir=c"
    assert exit_status(replay) in (0, None)
    summary = json.loads((tmp_path / "c" / "replay.json").read_text())
    total = sum(summary["states_s"].values())
    assert summary["states_s"]["drive"] > 0.9 * total and summary["rejected"] == {}
    assert summary["alignment"]["moving_within"] > 0.7
    assert (tmp_path / "c" / "commands.png").stat().st_size > 10_000

    outcomes = arrivals(simulated, (0.0, 0.0, yaw))
    assert outcomes.count("success") >= 2, outcomes
