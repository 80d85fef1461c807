"""Live topics of a robot, listened to for a while and read as a log."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from navrl.checks import check_positive
from navrl.deploy.bags.decoders import DECODERS
from navrl.deploy.bags.messages import Logged, Topic
from navrl.deploy.ros_bridge import Message

LIVE = ("ros1", "ros2")
"""Names of live topics, in place of the file of a log."""
_LOOK_S = 0.5  # between two looks for new topics
_DEPTH = 200  # messages that wait while others are decoded


class LiveLog:
    """Messages that were received from live topics, as a log.

    Args:
        name: One of :data:`LIVE`.
        topics: Topics by name.
        received: Messages in the order of their reception.
    """

    def __init__(self, name: str, topics: dict[str, Topic], received: list[Logged]) -> None:
        """Store the arguments."""
        self.file, self.topics = Path(name), topics
        self._received = received

    def messages(self, topics: Collection[str]) -> Iterator[Logged]:
        """Yield the messages of some topics in the order of their reception."""
        yield from (message for message in self._received if message.topic in topics)

    def close(self) -> None:
        """Do nothing: the subscriptions have ended."""


def listen(name: str, duration_s: float, use_sim_time: bool = False) -> LiveLog:
    """Listen to all live topics that a log may have.

    Args:
        name: One of :data:`LIVE`.
        duration_s: Time of listening, s.
        use_sim_time: Whether ``/clock`` gives the times of reception, as with a simulator; ROS 2
            only, ROS 1 has a parameter of the master for it.

    Raises:
        ValueError: If an argument is out of range, a message is malformed, or ROS 1 has no master.
        ModuleNotFoundError: If this ROS is not sourced.
    """
    if name not in LIVE:
        raise ValueError(f"name={name}: must be one of {', '.join(LIVE)}")
    check_positive(duration_s=duration_s)
    recorder = _Recorder()
    if name == "ros2":
        _listen_ros2(recorder, duration_s, use_sim_time)
    else:
        _listen_ros1(recorder, duration_s)
    return recorder.log(name)


class _Recorder:
    """Subscriptions of a node and what they received."""

    def __init__(self) -> None:
        self.policies: dict[str, tuple[str, str | None, str | None]] = {}
        self._received: list[Logged] = []
        self._problem = ""
        self._lock = threading.Lock()  # rospy has a thread per topic

    def subscription(
        self,
        topic: str,
        kinds: list[str],
        now: Callable[[], float],
        policies: tuple[str | None, str | None] = (None, None),
    ) -> tuple[Any, Callable[[Message], None]] | None:
        """Return class and callback for a new topic; None if its messages are not read.

        Args:
            topic: Name of the topic.
            kinds: Its types, e.g. ``nav_msgs/msg/Path``.
            now: Returns the time of reception, s.
            policies: Reliability and durability of its publishers.
        """
        kind = next((each for each in kinds if each in DECODERS), kinds[0])
        self.policies[topic] = (kind, *policies)
        type_class = _message_class(kind) if kind in DECODERS else None
        if type_class is None:
            return None
        return type_class, lambda message: self._receive(topic, kind, message, now())

    def _receive(self, topic: str, kind: str, message: Message, now: float) -> None:
        try:
            decoded = DECODERS[kind][1](message, topic, now)
        except ValueError as error:
            self._problem = self._problem or f"{topic}: {error}"
            return
        with self._lock:
            self._received.append(decoded)

    def log(self, name: str) -> LiveLog:
        """Return what was received.

        Raises:
            ValueError: If a message is malformed.
        """
        if self._problem:
            raise ValueError(self._problem)
        counts = Counter(message.topic for message in self._received)
        topics = {}
        for topic, (kind, reliability, durability) in sorted(self.policies.items()):
            meaning = DECODERS[kind][0] if kind in DECODERS else None
            topics[topic] = Topic(topic, meaning, kind, counts[topic], reliability, durability)
        return LiveLog(name, topics, self._received)


def _listen_ros2(recorder: _Recorder, duration_s: float, use_sim_time: bool) -> None:
    try:
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.parameter import Parameter
    except ImportError as error:
        raise _not_sourced("rclpy", "source /opt/ros/$ROS_DISTRO/setup.bash", error) from error
    context = Context()  # its own, the process may have another node
    rclpy.init(context=context)
    clock = [Parameter("use_sim_time", value=use_sim_time)]
    node = rclpy.create_node("navrl_doctor", context=context, parameter_overrides=clock)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    end, following = time.monotonic() + duration_s, 0.0
    try:
        while time.monotonic() < end:
            if time.monotonic() >= following:
                _subscribe_new(recorder, node)
                following = time.monotonic() + _LOOK_S
            executor.spin_once(timeout_sec=0.05)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def _subscribe_new(recorder: _Recorder, node: Message) -> None:
    """Subscribe to new topics with the quality of service that all their publishers offer."""
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    def now() -> float:
        return 1e-9 * node.get_clock().now().nanoseconds

    for topic, kinds in node.get_topic_names_and_types():
        offered = [each.qos_profile for each in node.get_publishers_info_by_topic(topic)]
        if topic in recorder.policies or not offered:
            continue
        reliable, latched = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
        if any(each.reliability != reliable for each in offered):
            reliable = ReliabilityPolicy.BEST_EFFORT
        if any(each.durability != latched for each in offered):
            latched = DurabilityPolicy.VOLATILE
        policies = (reliable.name.lower(), latched.name.lower())
        found = recorder.subscription(topic, kinds, now, policies)
        if found is not None:
            quality = QoSProfile(depth=_DEPTH, reliability=reliable, durability=latched)
            node.create_subscription(found[0], topic, found[1], quality)


def _listen_ros1(recorder: _Recorder, duration_s: float) -> None:
    try:
        import rosgraph
        import rospy
    except ImportError as error:
        remedy = "source /opt/ros/noetic/setup.bash, or install python3-rospy"
        raise _not_sourced("rospy", remedy, error) from error
    if not rosgraph.is_master_online():
        raise ValueError("ros1: must have a running master at ROS_MASTER_URI, start roscore")
    rospy.init_node("navrl_doctor", anonymous=True, disable_signals=True)
    end, subscribers = time.monotonic() + duration_s, []
    while (left := end - time.monotonic()) > 0.0:
        for topic, name in rospy.get_published_topics():
            if topic in recorder.policies:
                continue
            kinds = [name.replace("/", "/msg/", 1)]
            found = recorder.subscription(topic, kinds, rospy.get_time)
            if found is not None:
                subscribers.append(rospy.Subscriber(topic, found[0], found[1]))
        time.sleep(min(left, _LOOK_S))
    for subscriber in subscribers:
        subscriber.unregister()


def _not_sourced(name: str, remedy: str, error: ImportError) -> ModuleNotFoundError:
    return ModuleNotFoundError(f"live topics: must have {name} ({error}); {remedy}", name=name)


def _message_class(kind: str) -> type | None:
    """Return the class of a type; None if its package is not installed."""
    package, _, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        return None
