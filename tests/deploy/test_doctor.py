"""Findings about a log and the verdict."""

import json
import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from pages import exit_status

from navrl.deploy import ControlLimits, DriveState
from navrl.deploy.bags import LogSource, Topics, open_log
from navrl.deploy.doctor import measure_log, reading_kinds
from navrl.deploy.doctor_checks import diagnose
from navrl.deploy.doctor_findings import Checked, Level, verdict
from navrl.deploy.mount_guess import mount_by_motion, true_sectors
from navrl.ops.scanner import Scanner
from navrl.policies import ZOO, load_bundle
from navrl.sim import Lidar

made = pytest.importorskip("made_bags", reason="needs the extra bags", exc_type=ImportError)
ROOT = Path(__file__).parents[2]
RECORDING = "shared/data/lidar/legtracker_demo_60s.npz"  # beside the clone, or beside its folder


@pytest.fixture(scope="module")
def parts():
    bundle = load_bundle(ZOO / "paper")
    return bundle.build("lidar"), bundle.build("robot")


def examined(parts, file, mount=None, network_range=None, **topics):
    """Return measurements and findings of a log."""
    lidar, robot = parts
    with closing(open_log(file)) as log:
        source = LogSource(log, Topics(**topics))
        scanner, origin = source.scanner(source.first_scan(), Scanner(range_max=100.0), mount)
        found = measure_log(source, scanner, lidar, robot)
        policy = (lidar, robot, ControlLimits(), 0.2, network_range)
        facts = Checked(found, source, scanner, origin, *policy)
        return found, diagnose(facts)


def bad(findings):
    """Return subject and level of the findings that are not ok."""
    return {finding.subject: finding.level for finding in findings if finding.level}


def about(findings, subject):
    return " | ".join(f"{f.text} -> {f.action}" for f in findings if f.subject == subject)


@pytest.fixture(scope="module")
def good(parts, tmp_path_factory):
    return examined(parts, made.driven(tmp_path_factory.mktemp("bag"), duration_s=6.0))


@pytest.mark.parametrize("network_range, level", [(3.5, None), (None, Level.WARNING)])
def test_range_is_compared_with_that_of_the_network(parts, tmp_path, network_range, level):
    aligned = (Lidar(max_range=50.0), parts[1])  # the alignment reads more than the network
    log = made.driven(tmp_path, duration_s=6.0)
    _, findings = examined(aligned, log, network_range=network_range)
    assert bad(findings).get("range") is level


def test_whole_log_is_ok(good):
    found, findings = good
    assert bad(findings) == {} and verdict(findings) is Level.OK
    assert found.num_scans == 60 and found.beams == {360}
    assert found.readings == {"distance": 1.0}
    assert found.states == {DriveState.DRIVE: 60}
    assert found.driven_m == pytest.approx(2.95, abs=0.05)
    assert found.speeds == pytest.approx((0.0, 0.5, 0.1))
    assert "360 beams from -3.142 rad, counter-clockwise, 360 degrees" in about(
        findings, "field of view"
    )
    assert "10.0 Hz, longest gap 0.10 s" in about(findings, "scan rate")
    assert "/scan best_effort, volatile" in about(findings, "QoS")
    assert "0.50 m/s" in about(findings, "limits")


def test_mount_is_confirmed_by_the_motion_of_scans(good):
    found, findings = good
    assert found.mount.yaw == pytest.approx(0.0, abs=0.05) and found.mount.agreement > 0.99
    assert "from tf base_link <- laser; by the motion of" in about(findings, "mount")


@pytest.mark.parametrize("yaw", [math.pi, 0.5 * math.pi, -0.7])
def test_wrong_mount_is_a_failure_with_the_yaw(yaw, parts, tmp_path):
    """The lidar is turned, tf says that it is not."""
    bag = made.driven(tmp_path, duration_s=6.0, mount=(0.0, 0.0, yaw), told=(0.0, 0.0, 0.0))
    found, findings = examined(parts, bag)
    off = math.remainder(found.mount.yaw - yaw, math.tau)
    assert off == pytest.approx(0.0, abs=0.1)
    assert bad(findings)["mount"] is Level.FAILURE
    assert "mount=[0,0," in about(findings, "mount")
    assert "mount" not in bad(examined(parts, bag, (0.0, 0.0, yaw))[1])


def test_mirrored_scans_are_a_failure(parts, tmp_path):
    mirrored = {"duration_s": 4.0, "turn_rate": 0.8, "speed": 0.3, "change": lambda r: r[::-1]}
    found, findings = examined(parts, made.driven(tmp_path, **mirrored))
    assert found.mount.is_mirrored and bad(findings)["mount"] is Level.FAILURE
    assert "scanner.is_upside_down=true" in about(findings, "mount")


def test_mount_without_tf_is_a_warning(parts, tmp_path):
    _, findings = examined(parts, made.driven(tmp_path, without=("tf",)))
    assert bad(findings) == {"mount": Level.WARNING}
    assert "give mount=[x,y,yaw]" in about(findings, "mount")


def changed(index, value):
    def change(ranges):
        ranges = ranges.copy()
        ranges[index] = value
        return ranges

    return change


@pytest.mark.parametrize(
    ("options", "subject", "level", "text"),
    [
        ({"scan": {"late": 0.8}}, "scan age", Level.FAILURE, "0.800 s from stamp"),
        ({"scan": {"late": -0.5}}, "scan age", Level.FAILURE, "synchronize the clocks"),
        ({"every": 10}, "scan rate", Level.FAILURE, "2.0 Hz"),
        ({"every": 5}, "scan rate", Level.WARNING, "4.0 Hz"),
        ({"change": lambda r: 1000.0 * r}, "readings", Level.FAILURE, "millimeters"),
        ({"change": changed(slice(0, 180), np.nan)}, "readings", Level.WARNING, "50 % of the"),
        ({"change": changed(slice(0, 20), 0.0)}, "readings", Level.WARNING, "scanner.zero=invalid"),
        (
            {"change": changed(slice(90, 270), np.nan)},
            "scan check",
            Level.FAILURE,
            "as blind at 100 %",
        ),
        ({"change": changed(180, -np.inf)}, "scan check", Level.FAILURE, "as blocked at 100 %"),
        ({"scan": {"angle_increment": 1.0}}, "scan", Level.FAILURE, "scans are refused"),
        ({"pose_qos": "default"}, "QoS", Level.WARNING, "/amcl_pose is volatile"),
        ({"without": ("odometry",)}, "odometry", Level.WARNING, "no odometry"),
        ({"without": ("pose",)}, "pose", Level.WARNING, "no localization"),
        (
            {"without": ("pose",)},
            "pose",
            Level.WARNING,
            "tf has no transform from map to",
        ),
        ({"scan": {"range_max": 3.0}}, "range", Level.WARNING, "below the policy's 3.5 m"),
        ({"num_beams": 90}, "field of view", Level.WARNING, "4.0 degrees between beams"),
    ],
)
def test_each_fault_has_its_finding(options, subject, level, text, parts, tmp_path):
    _, findings = examined(parts, made.driven(tmp_path, **({"duration_s": 3.0} | options)))
    assert bad(findings)[subject] is level
    assert text in about(findings, subject)


def test_parts_of_the_robot_are_found(parts, tmp_path):
    """A post at 0.2 m and 90 degrees to the left, 4 degrees wide."""
    bag = made.driven(tmp_path, duration_s=6.0, change=changed(slice(268, 272), 0.2))
    found, findings = examined(parts, bag)
    ((bearing, width),) = found.own_sectors
    assert bearing == pytest.approx(0.5 * math.pi, abs=0.02)
    assert width == pytest.approx(math.radians(4.0), abs=0.02)
    assert f"scanner.blind_sectors=[[{bearing:g},{width:g}]]" in about(findings, "own parts")


def test_changing_beam_counts_are_reported(parts, tmp_path):
    def more(writer, time, pose):
        count = 1946 + round(time * 20) % 2
        step = 2.0 * math.pi / count
        bearings = -math.pi + step * np.arange(count)
        writer.scan("/a3", time, "laser", made.room(pose, bearings), angle_increment=step)

    found, findings = examined(parts, made.driven(tmp_path, duration_s=1.0, more=more), scan="/a3")
    assert found.beams == {1946, 1947}
    assert "1946 to 1947 beams" in about(findings, "field of view")


def test_readings_are_counted_by_kind():
    values = [1.0, 0.0, np.inf, -np.inf, np.nan, -1.0, 0.1, 12.0, 13.0]
    kinds = reading_kinds(np.array(values), 0.15, 12.0)
    assert kinds == {
        **{"distance": 1, "below range_min": 1, "range_max or more": 2, "0": 1, "inf": 1},
        **{"-inf": 1, "NaN": 1, "negative": 1},
    }
    assert sum(kinds.values()) == len(values)


def test_mount_needs_a_straight_drive():
    turning = [(np.array([0.0, 0.0, 0.2]), np.array([0.0, 0.0, 0.2]))] * 5
    assert mount_by_motion(turning)[:3] == (None, 0.0, False)


def test_sector_over_the_seam_is_one():
    flags = np.zeros(360, dtype=bool)
    flags[[358, 359, 0, 1]] = True
    ((bearing, width),) = true_sectors(flags)
    assert bearing == pytest.approx(-math.radians(0.5), abs=1e-3)
    assert width == pytest.approx(math.radians(4.0), abs=1e-3)


def test_command_ends_with_the_verdict(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    good = made.driven(tmp_path, duration_s=3.0, num_beams=360)
    words = "policy=paper training_scan=false"
    assert exit_status(f"navrl-doctor {good} {words} hydra.run.dir=a") == 0
    said = capsys.readouterr().out
    assert said.splitlines()[-1] == f"{good}: ok; details in a" or ": ok; details in" in said
    assert (tmp_path / "a" / "scan.png").stat().st_size > 10_000
    turned = made.driven(tmp_path, "sqlite3", duration_s=6.0, mount=(0, 0, 3.14), told=(0, 0, 0))
    assert exit_status(f"navrl-doctor {turned} {words} hydra.run.dir=b") == 3
    assert "FAILURE  mount: " in capsys.readouterr().out
    found = json.loads((tmp_path / "b" / "doctor.json").read_text())
    assert found["verdict"] == "will not work"
    assert {"level", "subject", "text", "do"} == found["findings"][0].keys()
    assert exit_status(f"navrl-doctor absent.bag {words}") == 2
    capsys.readouterr()
    assert exit_status(f"navrl-doctor {good} {words} +start_s=100") == 2
    error = "navrl: start_s=100: no effect, navrl-doctor has no such key"
    assert capsys.readouterr().err.startswith(error)


def test_warnings_fail_only_if_strict(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    bag = made.driven(tmp_path, duration_s=2.0, without=("tf",))
    words = "policy=paper training_scan=false"
    assert exit_status(f"navrl-doctor {bag} {words} hydra.run.dir=a") == 0
    assert ": warnings; details in" in capsys.readouterr().out
    assert exit_status(f"navrl-doctor {bag} {words} strict=true hydra.run.dir=b") == 3


@pytest.mark.parametrize("kind", ["ROBOTLASER1", "FLASER"])
def test_carmen_log_is_checked_as_a_bag(kind, parts, tmp_path):
    """180 beams over 180 degrees 5 Hz, the lidar 0.1 m ahead by the lines of the log."""
    found, findings = examined(parts, made.carmen(tmp_path / "office.log", 40, kind))
    assert found.num_scans == 40 and found.beams == {180}
    assert found.driven_m == pytest.approx(3.9, abs=0.01) and verdict(findings) is Level.WARNING
    assert bad(findings) == {"field of view": Level.WARNING}
    assert "180 beams from -1.571 rad, counter-clockwise, 180 degrees" in about(
        findings, "field of view"
    )
    assert "5.0 Hz, longest gap 0.20 s" in about(findings, "scan rate")
    assert f"(0.10 m, 0.00 m, 0 degrees) from the lines of {kind}; by the motion of" in about(
        findings, "mount"
    )


def test_real_recording_of_a_standing_robot(parts, tmp_path):
    """512 beams over 180 degrees, 66 % of the readings are 0, and 86 beams never return."""
    files = [folder / RECORDING for folder in (ROOT.parent, ROOT.parent.parent)]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        pytest.skip("needs lidar/legtracker_demo_60s.npz of the development data, ../shared/data")
    with np.load(file) as data:
        stamps, ranges = data["t"].astype(float), data["range_mm"] / 1000.0
        angles = {k: float(data[k]) for k in ("angle_min", "angle_increment", "range_max")}
    writer = made.Writer(tmp_path / "bag", "mcap")
    for stamp, row in zip(stamps[:100], ranges[:100], strict=True):
        writer.scan("/scan", made.START_S + stamp, "laser", row, range_min=0.02, **angles)
    writer.close()
    found, findings = examined(parts, tmp_path / "bag", pose_source="standing")
    assert found.beams == {512} and 0.6 < found.readings["0"] < 0.72
    assert bad(findings)["field of view"] is Level.WARNING
    assert "180 degrees" in about(findings, "field of view")
    assert "scanner.zero=invalid" in about(findings, "readings")
