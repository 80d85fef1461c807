"""The ROS 1 node, with a stand-in for rospy: zero is the last command, also of an exception."""

import sys
import threading
import time
from types import ModuleType, SimpleNamespace

import pytest
from map_files import write_map
from test_map_planner import goal, grid
from test_ros_bridge import odometry, path, scan

from navrl.deploy.ros1 import PolicyNode
from navrl.worlds import load_occupancy_map

MESSAGES = {
    "diagnostic_msgs": ("DiagnosticArray", "DiagnosticStatus", "KeyValue"),
    "geometry_msgs": ("PoseStamped", "PoseWithCovarianceStamped", "Twist", "TwistStamped"),
    "nav_msgs": ("OccupancyGrid", "Odometry", "Path"),
    "sensor_msgs": ("LaserScan",),
    "std_msgs": ("Bool",),
}


class Anything(SimpleNamespace):
    """A message whose fields are made when they are read."""

    def __getattr__(self, name):
        if name.startswith("__") or name in ("twist", "to_sec"):
            raise AttributeError(name)
        setattr(self, name, Anything())
        return getattr(self, name)


class Rospy:
    """The part of rospy that the node uses."""

    Time = SimpleNamespace(now=lambda: 0.0)

    def __init__(self, **parameters):
        self.parameters, self.sent, self.listeners = parameters, [], {}
        self.log = []

    def get_param(self, name, default):
        if name == "~":
            return self.parameters
        return self.parameters.get(name.removeprefix("~"), default)

    def get_time(self):
        return time.monotonic() + 100.0

    def Publisher(self, name, kind, queue_size, latch=False):
        return SimpleNamespace(publish=lambda message: self.sent.append((name, message)))

    def Subscriber(self, name, kind, callback, queue_size):
        self.listeners[name] = callback

    def logwarn(self, text):
        self.log.append(text)

    def loginfo(self, text):
        self.log.append(text)

    def logwarn_throttle(self, period, text):
        raise AssertionError(text)

    def speeds(self):
        return [message.linear.x for name, message in self.sent if name == "cmd_vel"]


@pytest.fixture(autouse=True)
def messages(monkeypatch):
    for package, names in MESSAGES.items():
        module = ModuleType(f"{package}.msg")
        for name in names:
            setattr(module, name, type(name, (Anything,), {}))
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f"{package}.msg", module)


def make(**changes):
    parameters = {"policy": "paper", "mount": [0.0, 0.0, 0.0], "pose_source": "odometry"}
    rospy = Rospy(**{**parameters, "scan_timeout": 30.0, "pose_timeout": 30.0, **changes})
    return rospy, PolicyNode(rospy)


def give(rospy):
    now = rospy.get_time()
    rospy.listeners["plan"](path())
    rospy.listeners["odom"](odometry(now))
    rospy.listeners["scan"](scan(now - 0.2))


def spin_until_fast(rospy, node):
    """Let the node spin until it commands 0.5 m/s, for at most a minute."""
    stopping = threading.Event()
    thread = threading.Thread(target=node.spin, args=(stopping,))
    thread.start()
    end = time.monotonic() + 60.0
    while max(rospy.speeds(), default=0.0) < 0.5 and time.monotonic() < end:
        time.sleep(0.02)
    stopping.set()
    thread.join()


def test_node_drives_and_ends_with_zero():
    rospy, node = make()
    give(rospy)
    spin_until_fast(rospy, node)
    assert max(rospy.speeds()) > 0.5 and rospy.speeds()[-5:] == [0.0] * 5


def test_node_plans_to_goals_on_a_map(tmp_path):
    rospy, node = make(path_source="map")
    assert "plan" not in rospy.listeners
    now = rospy.get_time()
    rospy.listeners["map"](grid(load_occupancy_map(write_map(tmp_path))))
    rospy.listeners["move_base_simple/goal"](goal(2.8, 0.0))
    rospy.listeners["odom"](odometry(now, x=0.5))
    rospy.listeners["scan"](scan(now - 0.2))
    spin_until_fast(rospy, node)
    plans = [message for name, message in rospy.sent if name == "plan"]
    assert len(plans) == 1 and plans[0].header.frame_id == "map"
    last = plans[0].poses[-1].pose.position
    assert (last.x, last.y) == pytest.approx((2.8, 0.0)) and max(rospy.speeds()) > 0.5


def test_log_names_unknown_parameters_and_when_it_is_ready():
    rospy, node = make(mount=[0, 0, 3], max_vel_x=1, max_vel_y=0.5)
    unknown, ready = rospy.log
    assert unknown.startswith("max_vel_y=0.5: no effect, the node has no such parameter; did you")
    assert "max_vel_x" in unknown
    assert ready.startswith("ready: policy=paper, scanner=any at mount=[0.000, 0.000, 3.000], pose")
    assert ready.endswith("listens to scan, odom, plan, emergency_stop; publishes cmd_vel")
    assert node.control.limits.max_speed == 1.0


def test_exception_ends_with_zero(monkeypatch):
    rospy, node = make()
    monkeypatch.setattr(node.control, "tick", lambda now: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        node.spin(threading.Event())
    assert rospy.speeds() == [0.0] * 5


def test_dry_run_sends_nothing():
    rospy, node = make(dry_run=True)
    node.send(0.5, 0.0)
    assert rospy.speeds() == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pose_source": "tf"}, "pose_source=tf: must be one of amcl_pose, odometry"),
        ({"controller_frequency": 2.0}, "controller_frequency=2.0: must be at least 10 Hz"),
        ({"mount": [float("nan")] * 3}, "mount: must be three numbers"),
        ({"mount": [0.0, 3.14]}, r"mount=\[0.0, 3.14\]: must be three finite numbers"),
        ({"mount": [0, 0, 180]}, "mount=.*: yaw=180: must be in rad"),
        ({"mount": "front"}, "mount='front': must be a list of numbers"),
        ({"max_vel_x": -0.5}, "max_vel_x=-0.5: must be positive"),
        ({"decel_lim_x": float("nan")}, "decel_lim_x=nan: must be positive"),
        ({"scan_timeout": "1"}, "scan_timeout='1': must be a number"),
        ({"xy_goal_tolerance": -1.0}, "xy_goal_tolerance=-1.0: must be >= 0"),
        ({"min_measured_share": 2.0}, "min_measured_share=2.0: must be in"),
        ({"dry_run": "yes"}, "dry_run='yes': must be true or false"),
        ({"occupied_thresh": 0.2}, "free_thresh=0.25: must be in 0 to below occupied_thresh=0.2"),
    ],
)
def test_parameters_without_tf_are_required(changes, message):
    with pytest.raises(ValueError, match=message):
        make(**changes)
