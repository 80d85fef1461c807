"""Reading of bags of ROS 1 and ROS 2 and of CARMEN logs."""

import importlib.util
import math
from collections import Counter

import numpy as np
import pytest

from navrl.deploy.bags import (
    FrameTransform,
    FrameTree,
    LoggedCommand,
    LoggedOdometry,
    LoggedPath,
    LoggedPose,
    LoggedScan,
    LogSource,
    Topics,
    choose_topic,
    homogeneous,
    open_log,
)
from navrl.ops.scanner import Scanner
from navrl.untrusted import DamagedFileError

made = pytest.importorskip("made_bags", reason="needs the extra bags", exc_type=ImportError)


@pytest.fixture(scope="module", params=made.FORMS)
def bag(request, tmp_path_factory):
    return made.driven(tmp_path_factory.mktemp("bag"), request.param, mount=(0.1, 0.0, 0.0))


def of_kind(source, kind):
    return [message for message in source.messages() if isinstance(message, kind)]


def test_all_formats_give_the_same_messages(bag):
    source = LogSource(open_log(bag), Topics())
    scan, odometry = of_kind(source, LoggedScan)[1], of_kind(source, LoggedOdometry)[2]
    pose, command = of_kind(source, LoggedPose)[1], of_kind(source, LoggedCommand)[0]
    assert (scan.topic, scan.frame, scan.duration_s) == ("/scan", "laser", None)
    assert scan.stamp == pytest.approx(made.START_S + 0.1, abs=1e-6) == scan.received
    assert scan.ranges.dtype == np.float64 and scan.ranges.shape == (360,)
    bearings = -math.pi + 2 * math.pi / 360 * np.arange(360)
    assert scan.ranges == pytest.approx(made.room((0.15, 0.0, 0.01), bearings), abs=1e-2)
    assert scan.angle_min == pytest.approx(-math.pi)
    assert scan.angle_increment == pytest.approx(2 * math.pi / 360)
    assert (scan.range_min, scan.range_max) == pytest.approx((0.15, 12.0))
    assert odometry.pose == pytest.approx((3.05, 0.0, 0.01), abs=1e-3)
    assert odometry.velocity == (0.5, 0.1) == command.command
    assert pose.frame == "map" and pose.pose == pytest.approx((0.1, 0.0, 0.02), abs=2e-3)
    (path,) = of_kind(source, LoggedPath)
    assert path.points.shape == (101, 2) and path.points[-1].tolist() == [5.0, 0.0]


def test_messages_come_in_order_of_reception(bag):
    times = [message.received for message in LogSource(open_log(bag), Topics()).messages()]
    assert times == sorted(times) and len(times) == 80 + 80 + 40 + 20 + 1


def test_quality_of_service_is_read(tmp_path):
    log = open_log(made.driven(tmp_path, "sqlite3"))
    assert (log.topics["/scan"].reliability, log.topics["/scan"].durability) == (
        "best_effort",
        "volatile",
    )
    assert log.topics["/amcl_pose"].durability == "transient_local"


def test_mount_comes_from_tf_unless_given(bag):
    source = LogSource(open_log(bag), Topics())
    scan = source.first_scan()
    scanner, origin = source.scanner(scan, Scanner())
    assert scanner.mount == pytest.approx((0.1, 0.0, 0.0)) and "tf base_link <- laser" in origin
    scanner, origin = source.scanner(scan, Scanner(), (0.0, 0.0, 1.0))
    assert scanner.mount == (0.0, 0.0, 1.0) and origin == "the option mount"


def test_two_scan_topics_are_named(tmp_path):
    def rear(writer, time, pose):
        writer.scan("/rear/scan", time, "rear", np.full(90, 2.0))

    log = open_log(made.driven(tmp_path, duration_s=1.0, more=rear))
    with pytest.raises(ValueError, match=r"scan_topic=null: must be chosen.*/rear/scan, /scan"):
        LogSource(log, Topics())
    assert LogSource(log, Topics(scan="rear/scan")).scan == "/rear/scan"
    with pytest.raises(ValueError, match=r"scan_topic=/odom: must be one of .*/scan, /"):
        LogSource(log, Topics(scan="/odom"))


def test_usual_topic_is_preferred(tmp_path):
    def other(writer, time, pose):
        writer.write("/cmd_vel_nav", writer.twist(1.0, 0.0), time)

    log = open_log(made.driven(tmp_path, duration_s=1.0, more=other))
    assert choose_topic(log, "command") == "/cmd_vel"


def test_bag_without_scans_lists_its_topics(tmp_path):
    writer = made.Writer(tmp_path / "bag", "mcap")
    writer.odometry(made.START_S, (0.0, 0.0, 0.0), 0.0, 0.0)
    writer.close()
    with pytest.raises(
        ValueError, match=r"LaserScan, has /odom \(nav_msgs/msg/Odometry, messages: 1\)"
    ):
        LogSource(open_log(tmp_path / "bag"), Topics())


def test_pose_from_tf_is_that_of_the_map(tmp_path):
    def frames(writer, time, pose):
        writer.frame(time, "map", "odom", (10.0, 0.0, math.pi / 2))
        writer.frame(time, "odom", "base_link", pose)

    file = made.driven(tmp_path, duration_s=1.0, more=frames, without=("pose",))
    source = LogSource(open_log(file), Topics())
    assert source.pose_source == "tf"
    last = of_kind(source, LoggedPose)[-1]
    driven = of_kind(source, LoggedOdometry)[-1].pose
    assert last.pose == pytest.approx((10.0 - driven[1], driven[0] - 3.0, driven[2] + math.pi / 2))


def test_odometry_is_the_pose_without_localization(tmp_path):
    file = made.driven(tmp_path, duration_s=1.0, without=("pose",))
    source = LogSource(open_log(file), Topics())
    assert source.pose_source == "odometry"
    assert len(of_kind(source, LoggedPose)) == len(of_kind(source, LoggedOdometry)) == 20
    with pytest.raises(ValueError, match="pose_source=tf: must be in the log"):
        LogSource(open_log(file), Topics(pose_source="tf"))


def test_robot_without_poses_may_be_standing(tmp_path):
    file = made.driven(tmp_path, duration_s=1.0, without=("pose", "odometry", "tf"))
    with pytest.raises(ValueError, match="pose_source=standing"):
        LogSource(open_log(file), Topics())
    source = LogSource(open_log(file), Topics(pose_source="standing"))
    assert {message.pose for message in of_kind(source, LoggedPose)} == {(0.0, 0.0, 0.0)}


def test_changing_beam_count_is_kept(tmp_path):
    def other(writer, time, pose):
        count = 1946 + (round(time * 20) % 2)
        writer.scan("/a3", time, "laser", np.full(count, 2.0))

    log = open_log(made.driven(tmp_path, duration_s=1.0, more=other))
    source = LogSource(log, Topics(scan="/a3"))
    assert {len(scan.ranges) for scan in of_kind(source, LoggedScan)} == {1946, 1947}


@pytest.mark.parametrize("form", made.FORMS)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_cut_bag_is_one_line_with_the_file(form, share, tmp_path):
    bag = made.driven(tmp_path, form, duration_s=2.0)
    whole = next(p for p in (bag, *bag.glob("*.db3"), *bag.glob("*.mcap")) if p.is_file())
    cut = tmp_path / f"cut{whole.suffix}"
    cut.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
    with pytest.raises(DamagedFileError) as caught:
        list(LogSource(open_log(cut), Topics()).messages())
    line = str(caught.value)
    assert line.startswith(f"{cut}: ") and "\n" not in line and "reindex" in line


def test_damaged_message_is_named_by_topic_and_time(tmp_path):
    bag = made.driven(tmp_path, "mcap", duration_s=2.0)
    (whole,) = bag.glob("*.mcap")
    data, mark = bytearray(whole.read_bytes()), b"base_link"
    places = [k for k in range(len(data)) if data.startswith(mark, k)]
    data[places[-30] - 4 : places[-30]] = b"\xff\xff\xff\x7f"  # length of a string
    whole.write_bytes(bytes(data))
    with pytest.raises(DamagedFileError, match=r"/odom, message at 17000000\d\d\.\d+ s: damaged"):
        list(LogSource(open_log(bag), Topics()).messages())


def test_folder_without_metadata_is_an_error(tmp_path):
    bag = made.driven(tmp_path, "mcap", duration_s=1.0)
    (bag / "metadata.yaml").unlink()
    with pytest.raises(DamagedFileError, match=r"metadata"):
        open_log(bag)
    (whole,) = bag.glob("*.mcap")  # the file alone is whole
    assert open_log(whole).topics["/scan"].count == 10


def test_unknown_suffix_and_missing_file_are_errors(tmp_path):
    (tmp_path / "a.csv").write_text("t")
    with pytest.raises(ValueError, match=r"bag=.*a\.csv: must be a \.bag of ROS 1"):
        open_log(tmp_path / "a.csv")
    with pytest.raises(FileNotFoundError, match=r"b\.bag"):
        open_log(tmp_path / "b.bag")


def test_missing_extra_is_named(tmp_path, monkeypatch):
    bag = made.driven(tmp_path, "mcap", duration_s=0.5)
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "navrl.extras.find_spec", lambda name: None if name == "rosbags" else find(name)
    )
    with pytest.raises(ModuleNotFoundError, match=r"a bag: needs rosbags; .*\[bags\]"):
        open_log(bag)


# --- CARMEN --------------------------------------------------------------------------------------


def test_robot_laser_has_angles_mount_and_motion(tmp_path):
    source = LogSource(open_log(made.carmen(tmp_path / "a.log")), Topics())
    scans, odometry = of_kind(source, LoggedScan), of_kind(source, LoggedOdometry)
    assert len(scans) == 20 and scans[1].stamp == pytest.approx(1000.2)
    assert scans[0].mount == pytest.approx((0.1, 0.0, 0.0), abs=1e-6)
    assert scans[0].angle_min == -1.570796 and scans[0].angle_increment == 0.017453
    bearings = np.radians(np.arange(180) - 90.0)
    assert scans[3].ranges[:-1] == pytest.approx(
        made.room((0.4, 0.0, 0.0), bearings)[:-1], abs=0.01
    )
    assert scans[0].ranges[-1] == math.inf
    assert odometry[0].velocity == (0.0, 0.0)
    assert odometry[5].velocity == pytest.approx((0.5, 0.0), abs=1e-6)
    assert odometry[5].pose == pytest.approx((0.5, 0.0, 0.0), abs=1e-6)  # yaw is wrapped
    assert source.pose_source == "pose"
    scanner, origin = source.scanner(scans[0], Scanner())
    assert scanner.mount == scans[0].mount and "ROBOTLASER1" in origin


def test_front_laser_has_conventional_angles_and_its_parameter(tmp_path):
    source = LogSource(open_log(made.carmen(tmp_path / "a.log", kind="FLASER")), Topics())
    scan, pose = of_kind(source, LoggedScan)[0], of_kind(source, LoggedPose)[2]
    assert scan.mount == (0.1, 0.0, 0.0)
    assert scan.angle_min == -math.pi / 2 and scan.angle_increment == math.radians(1.0)
    assert source.odometry == "ODOM"
    assert of_kind(source, LoggedOdometry)[0].velocity == (0.5, 0.0)
    assert pose.pose == pytest.approx((0.2, 0.0, 0.0))  # of the robot, not of its laser
    assert of_kind(source, LoggedOdometry)[2].pose == pytest.approx((0.2, 0.5, 0.0))


@pytest.mark.parametrize(
    ("number", "change", "reason"),
    [
        (5, lambda line: line[: len(line) // 2], r"line 5: ROBOTLASER1: must have 180 readings"),
        (5, lambda line: line.replace(" 180 ", " 999999 "), "must have 1 to 20,000 readings"),
        (5, lambda line: line.replace(" 180 ", " many "), "line 5: ROBOTLASER1: invalid literal"),
        (5, lambda line: line.rsplit(" ", 3)[0], "line 5: ROBOTLASER1: must have 1 numbers"),
        (5, lambda line: line.replace(" 81.0 ", " nan "), "must be finite numbers"),
        (5, lambda line: line + "é", "line 5: must be plain text"),
    ],
)
def test_torn_line_of_carmen_is_named(number, change, reason, tmp_path):
    file = made.carmen(tmp_path / "a.log")
    lines = file.read_text().splitlines()
    lines[number - 1] = change(lines[number - 1])
    file.write_text("\n".join(lines))
    with pytest.raises(DamagedFileError, match=reason) as caught:
        list(LogSource(open_log(file), Topics()).messages())
    assert str(caught.value).startswith(f"{file}: ")


def test_text_that_is_no_log_is_an_error(tmp_path):
    (tmp_path / "a.log").write_text("Traceback: none\n")
    with pytest.raises(DamagedFileError, match="no line begins with FLASER, RLASER"):
        open_log(tmp_path / "a.log")


# --- frames --------------------------------------------------------------------------------------


def test_frames_are_connected_through_a_shared_ancestor():
    tree, flat = FrameTree(), (0.0, 0.0, 0.0, 1.0)
    tree.add(FrameTransform("base", "plate", 5.0, homogeneous((1.0, 0.0, 0.1), flat), True))
    tree.add(FrameTransform("base", "mast", 7.0, homogeneous((0.0, 2.0, 0.1), made.TURNED), False))
    placed = tree.lookup("mast", "plate")
    assert placed.pose == pytest.approx((-1.0, 2.0, math.pi)) and placed.stamp == 7.0
    assert tree.lookup("mast", "laser") is None


def test_upside_down_lidar_has_a_tilt_of_half_a_turn(tmp_path):
    rolled = (1.0, 0.0, 0.0, 0.0)
    file = made.driven(tmp_path, duration_s=0.5, mount=(0.0, 0.0, 0.0), turn=rolled)
    source = LogSource(open_log(file), Topics())
    assert source.tree.lookup("base_link", "laser").tilt == pytest.approx(math.pi)
    assert source.scanner(source.first_scan(), Scanner())[0].is_upside_down


def test_circle_of_frames_is_not_connected():
    tree = FrameTree()
    tree.add(FrameTransform("a", "b", 0.0, np.eye(4), True))
    tree.add(FrameTransform("b", "a", 0.0, np.eye(4), True))
    assert tree.lookup("a", "b") is None


def test_counts_of_topics_are_those_of_the_messages(bag):
    log = open_log(bag)
    found = Counter(message.topic for message in log.messages(log.topics))
    assert found == {name: topic.count for name, topic in log.topics.items()}
