"""The doctor listens to the topics of a running ROS."""

import re
import sys
from types import ModuleType, SimpleNamespace

import pytest
from pages import exit_status

from navrl.deploy.bags import listen, live_topics, open_log

made = pytest.importorskip("made_bags", reason="needs the extra bags", exc_type=ImportError)


class Rospy:
    """A ROS 1 network that plays a bag while the listener sleeps."""

    def __init__(self, bag):
        from rosbags.highlevel import AnyReader

        self.now, self.listeners, self.left = 0.0, {}, []
        with AnyReader([bag]) as reader:
            self.kinds = {c.topic: c.msgtype.replace("/msg/", "/") for c in reader.connections}
            self.rows = [
                (c.topic, time / 1e9, reader.deserialize(data, c.msgtype))
                for c, time, data in reader.messages()
            ]

    def init_node(self, name, anonymous, disable_signals):
        assert anonymous and disable_signals

    def get_published_topics(self):
        return [[*each] for each in (*self.kinds.items(), ("/rosout", "rosgraph_msgs/Log"))]

    def Subscriber(self, topic, kind, callback):
        assert kind.__name__ == self.kinds[topic].partition("/")[2]
        self.listeners[topic] = callback
        return SimpleNamespace(unregister=lambda: self.left.append(topic))

    def get_time(self):
        return self.now

    def monotonic(self):
        return self.now

    def sleep(self, duration):
        for topic, now, message in self.rows:
            self.now = now
            self.listeners[topic](message)


@pytest.fixture
def rospy(tmp_path, monkeypatch):
    """Return a network whose robot has a lidar that is mounted backwards, with a wrong tf."""
    mounted = {"mount": (0.0, 0.0, 3.14159), "told": (0.0, 0.0, 0.0)}
    rospy = Rospy(made.driven(tmp_path, "ros1", duration_s=6.0, **mounted))
    rospy.is_online = True
    modules = {}  # never those of an installed ROS 2
    for kind in rospy.kinds.values():
        package, name = kind.split("/")
        messages = modules.setdefault(package, ModuleType(f"{package}.msg"))
        setattr(messages, name, type(name, (), {}))
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f"{package}.msg", messages)
    master = SimpleNamespace(is_master_online=lambda: rospy.is_online)
    monkeypatch.setitem(sys.modules, "rospy", rospy)
    monkeypatch.setitem(sys.modules, "rosgraph", master)
    monkeypatch.setattr(live_topics, "time", rospy)
    return rospy


def test_ros1_topics_give_the_messages_of_a_bag(rospy, tmp_path):
    log, bag = listen("ros1", 3.0), open_log(tmp_path / "drive.bag")
    assert {t.name: (t.kind, t.count) for t in log.topics.values() if t.kind} == {
        t.name: (t.kind, t.count) for t in bag.topics.values()
    }
    for live, logged in zip(log.messages(log.topics), bag.messages(bag.topics), strict=True):
        assert (live.topic, live.stamp, live.frame) == (logged.topic, logged.stamp, logged.frame)
        assert live.received == pytest.approx(logged.received, abs=1e-6)
    assert sorted(rospy.left) == sorted(rospy.kinds)


def test_doctor_finds_a_wrong_mount_on_ros1_topics(rospy, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = "policy=paper training_scan=false listen_s=3 hydra.run.dir=a"
    assert exit_status(f"navrl-doctor ros1 {words}") == 3
    printed = capsys.readouterr().out
    assert "FAILURE  mount: " in printed and re.search(r"'mount=\[0,0,-?3\.1", printed)
    assert printed.splitlines()[-1].startswith("ros1: will not work")


def test_malformed_live_message_is_named(rospy):
    quaternion = next(m for t, _, m in rospy.rows if t == "/tf_static").transforms[0]
    quaternion.transform.rotation.z = 0.0
    quaternion.transform.rotation.w = 0.0
    with pytest.raises(ValueError, match=r"/tf_static: transform=.*: must be finite"):
        listen("ros1", 3.0)


def test_missing_master_is_an_error(rospy):
    rospy.is_online = False
    with pytest.raises(ValueError, match="ros1: must have a running master"):
        listen("ros1", 3.0)


@pytest.mark.parametrize(
    ("name", "duration_s", "message"),
    [
        ("ros3", 1.0, "name=ros3: must be one of ros1, ros2"),
        ("ros2", 0.0, "duration_s=0.0: must be positive"),
    ],
)
def test_wrong_argument_of_listen_is_named(name, duration_s, message):
    with pytest.raises(ValueError, match=message):
        listen(name, duration_s)


@pytest.mark.parametrize(("name", "module"), [("ros1", "rospy"), ("ros2", "rclpy")])
def test_doctor_without_ros_is_a_user_error(name, module, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)  # its import fails
    monkeypatch.setitem(sys.modules, "rosgraph", ModuleType("rosgraph"))
    assert exit_status(f"navrl-doctor {name} policy=paper hydra.run.dir=a") == 2
    assert f"live topics: must have {module}" in capsys.readouterr().err
