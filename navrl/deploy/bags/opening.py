"""Opening of a log of any format, and the choice of its topics."""

from __future__ import annotations

from pathlib import Path

from navrl.deploy.bags.carmen_log import CarmenLog
from navrl.deploy.bags.messages import Kind, Log, Topic
from navrl.deploy.bags.ros_log import RosLog

_BAGS = (".bag", ".db3", ".mcap")
_TEXTS = (".log", ".clf", ".txt", "")
# Topics that are taken among several: the defaults of the nodes.
_USUAL = {"odometry": "odom", "pose": "amcl_pose", "path": "plan", "command": "cmd_vel"}
_NOT_POSES = ("initialpose", "goal_pose", "goal", "clicked_point")
_NAMES = {
    "scan": "sensor_msgs/LaserScan",
    "odometry": "nav_msgs/Odometry",
    "pose": "geometry_msgs/PoseWithCovarianceStamped",
    "path": "nav_msgs/Path",
    "command": "geometry_msgs/Twist",
}


def open_log(file: str | Path) -> Log:
    """Open a log; its format follows from its name.

    Args:
        file: ``.bag`` of ROS 1; ``.db3``, ``.mcap`` or folder of ROS 2; text of CARMEN (``.log``,
            ``.clf``, ``.txt`` or no suffix).

    Raises:
        FileNotFoundError: If there is no such file or folder.
        ValueError: If the suffix is unknown.
        DamagedFileError: If it cannot be read; one line with file and place.
        ModuleNotFoundError: If it is a bag and the extra ``bags`` is not installed.
    """
    file = Path(file)
    if not file.exists():
        raise FileNotFoundError(2, "No such file or directory", str(file))
    if file.is_dir() or file.suffix in _BAGS:
        return RosLog(file)
    if file.suffix in _TEXTS:
        return CarmenLog(file)
    raise ValueError(
        f"bag={file}: must be a .bag of ROS 1, a .db3, .mcap or folder of ROS 2, or a CARMEN log "
        "(.log, .clf, .txt)"
    )


def choose_topic(log: Log, kind: Kind, name: str | None = None, key: str = "") -> str | None:
    """Return the topic of a kind.

    Args:
        log: The log.
        kind: What its messages are.
        name: The topic, with or without its leading slash; None to choose the only one, or the
            usual one (``/odom``, ``/amcl_pose``, ``/plan``, ``/cmd_vel``).
        key: Name of the option in errors; ``KIND_topic`` if empty.

    Returns:
        Its name in the log; None if there is none and none was named.

    Raises:
        ValueError: If the named topic does not exist or has other messages, or if there are several
            and none was named; the message lists them.
    """
    key = key or f"{kind}_topic"
    known = [topic.name for topic in log.topics.values() if topic.kind == kind and topic.count]
    if name is not None:
        found = [each for each in known if each.lstrip("/") == name.lstrip("/")]
        if not found:
            listed = ", ".join(known) or "none, the log has no such messages"
            raise ValueError(f"{key}={name}: must be one of {listed}")
        return found[0]
    if kind == "pose":
        known = [each for each in known if _is_pose(log.topics[each])]
    usual = [each for each in known if each.lstrip("/") == _USUAL.get(kind)]
    if usual or len(known) < 2:
        return (usual or known or [None])[0]
    raise ValueError(f"{key}=null: must be chosen, {log.file} has {', '.join(sorted(known))}")


def choose_scans(log: Log, name: str | None = None) -> str:
    """Return the topic of the scans.

    Raises:
        ValueError: If :func:`choose_topic` raises it, or the log has no scans.
    """
    topic = choose_topic(log, "scan", name)
    if topic is None:
        listed = (f"{t.name} ({t.type_name}, messages: {t.count})" for t in log.topics.values())
        found = ", ".join(listed) or "nothing"
        raise ValueError(f"{log.file}: must have {_NAMES['scan']}, has {found}")
    return topic


def _is_pose(topic: Topic) -> bool:
    """Return whether a topic has the robot's pose, not a goal."""
    is_goal = topic.name.rpartition("/")[2] in _NOT_POSES
    return not is_goal and topic.type_name.rpartition("/")[2] != "PoseStamped"
