"""Small bags and logs of a robot that drives, written with the writers of rosbags."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FORMS = ("ros1", "sqlite3", "mcap")
START_S = 1_700_000_000.0
TURNED = (0.0, 0.0, 1.0, 0.0)  # quaternion of half a turn
QOS = {
    name: Qos(
        QosHistory.KEEP_LAST,
        5,
        QosReliability[reliability],
        QosDurability[durability],
        QosTime(0, 0),
        QosTime(0, 0),
        QosLiveliness.AUTOMATIC,
        QosTime(0, 0),
        False,
    )
    for name, reliability, durability in (
        ("sensor", "BEST_EFFORT", "VOLATILE"),
        ("default", "RELIABLE", "VOLATILE"),
        ("latched", "RELIABLE", "TRANSIENT_LOCAL"),
    )
}


def room(pose: Sequence[float], bearings: np.ndarray) -> np.ndarray:
    """Return the ranges ``[M]`` m in a room of 8 m by 5 m, from -1 to 7 and -2 to 3."""
    x, y, yaw = pose
    cos, sin = np.cos(bearings + yaw), np.sin(bearings + yaw)
    with np.errstate(divide="ignore"):
        along = np.where(cos > 0, (7.0 - x) / cos, (-1.0 - x) / cos)
        across = np.where(sin > 0, (3.0 - y) / sin, (-2.0 - y) / sin)
    return np.minimum(np.abs(along), np.abs(across))


class Writer:
    """Writer of messages by topic, type and time for all formats.

    Args:
        file: ``NAME.bag`` for ROS 1, a folder otherwise.
        form: One of :data:`FORMS`.
    """

    def __init__(self, file: Path, form: str) -> None:
        self.is_ros1 = form == "ros1"
        self.types = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        if self.is_ros1:  # its typestore has no tf2_msgs
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self.types.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
        plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        made = Writer1(file) if self.is_ros1 else Writer2(file, version=9, storage_plugin=plugin)
        self.file = file
        self._writer: Any = made
        self._writer.open()
        self._topics: dict[str, Any] = {}

    def make(self, name: str, **fields: Any) -> Any:
        """Return a message; ROS 1 has a counter in each header."""
        if self.is_ros1 and name == "std_msgs/msg/Header":
            fields["seq"] = 0
        return self.types.types[name](**fields)

    def header(self, time: float, frame: str) -> Any:
        whole = math.floor(time)
        stamp = self.make(
            "builtin_interfaces/msg/Time", sec=whole, nanosec=round((time - whole) * 1e9)
        )
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def pose(self, pose: Sequence[float], turn: Sequence[float] | None = None) -> Any:
        x, y, yaw = pose
        turn = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)) if turn is None else turn
        position = self.make("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
        quaternion = dict(zip("xyzw", turn, strict=True))
        orientation = self.make("geometry_msgs/msg/Quaternion", **quaternion)
        return self.make("geometry_msgs/msg/Pose", position=position, orientation=orientation)

    def twist(self, v: float, w: float) -> Any:
        linear = self.make("geometry_msgs/msg/Vector3", x=v, y=0.0, z=0.0)
        angular = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=w)
        return self.make("geometry_msgs/msg/Twist", linear=linear, angular=angular)

    def write(self, topic: str, message: Any, time: float, qos: str = "default") -> None:
        name = message.__msgtype__
        if topic not in self._topics:
            options = {"latching": int(qos == "latched")}
            if not self.is_ros1:
                options = {"offered_qos_profiles": [QOS[qos]]}
            self._topics[topic] = self._writer.add_connection(
                topic, name, typestore=self.types, **options
            )
        pack = self.types.serialize_ros1 if self.is_ros1 else self.types.serialize_cdr
        self._writer.write(self._topics[topic], round(time * 1e9), bytes(pack(message, name)))

    def scan(
        self, topic: str, time: float, frame: str, ranges: np.ndarray, **fields: float
    ) -> None:
        """Write a scan; by default the beams spread over a full circle from -pi."""
        late = fields.pop("late", 0.0)
        values = {"angle_min": -math.pi, "angle_increment": 2 * math.pi / len(ranges)}
        values |= {"angle_max": math.pi, "time_increment": 0.0, "scan_time": 0.1}
        values |= {"range_min": 0.15, "range_max": 12.0} | fields
        message = self.make(
            "sensor_msgs/msg/LaserScan",
            header=self.header(time, frame),
            ranges=ranges.astype(np.float32),
            intensities=np.zeros(0, np.float32),
            **values,
        )
        self.write(topic, message, time + late, "sensor")

    def odometry(self, time: float, pose: Sequence[float], v: float, w: float) -> None:
        covariance = np.zeros(36)
        placed = self.make(
            "geometry_msgs/msg/PoseWithCovariance", pose=self.pose(pose), covariance=covariance
        )
        moved = self.make(
            "geometry_msgs/msg/TwistWithCovariance", twist=self.twist(v, w), covariance=covariance
        )
        message = self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(time, "odom"),
            child_frame_id="base_link",
            pose=placed,
            twist=moved,
        )
        self.write("/odom", message, time, "sensor")

    def located(self, time: float, pose: Sequence[float], qos: str = "latched") -> None:
        placed = self.make(
            "geometry_msgs/msg/PoseWithCovariance", pose=self.pose(pose), covariance=np.zeros(36)
        )
        name = "geometry_msgs/msg/PoseWithCovarianceStamped"
        message = self.make(name, header=self.header(time, "map"), pose=placed)
        self.write("/amcl_pose", message, time, qos)

    def path(self, time: float, points: Sequence[Sequence[float]]) -> None:
        poses = [
            self.make(
                "geometry_msgs/msg/PoseStamped",
                header=self.header(time, "map"),
                pose=self.pose((x, y, 0.0)),
            )
            for x, y in points
        ]
        message = self.make("nav_msgs/msg/Path", header=self.header(time, "map"), poses=poses)
        self.write("/plan", message, time)

    def frame(
        self,
        time: float,
        parent: str,
        child: str,
        pose: Sequence[float],
        turn: Sequence[float] | None = None,
        is_static: bool = False,
    ) -> None:
        placed = self.pose(pose, turn)
        place = self.make("geometry_msgs/msg/Vector3", x=pose[0], y=pose[1], z=0.3)
        moved = self.make(
            "geometry_msgs/msg/Transform", translation=place, rotation=placed.orientation
        )
        name = "geometry_msgs/msg/TransformStamped"
        header = self.header(time, parent)
        stamped = self.make(name, header=header, child_frame_id=child, transform=moved)
        message = self.make("tf2_msgs/msg/TFMessage", transforms=[stamped])
        self.write(
            "/tf_static" if is_static else "/tf",
            message,
            time,
            "latched" if is_static else "default",
        )

    def close(self) -> None:
        self._writer.close()


def driven(
    folder: Path,
    form: str = "mcap",
    duration_s: float = 4.0,
    num_beams: int = 360,
    speed: float = 0.5,
    turn_rate: float = 0.1,
    mount: Sequence[float] = (0.0, 0.0, 0.0),
    more: Callable[[Writer, float, tuple[float, float, float]], None] | None = None,
    **options: Any,
) -> Path:
    """Write a bag of a robot that drives an arc in a room, and return its path.

    Scans at 10 Hz, odometry at 20 Hz in a frame of its own, poses at 5 Hz, one path, commands.

    Args:
        folder: Folder of the bag.
        form: One of :data:`FORMS`.
        duration_s: Time, s.
        num_beams: Beams of the lidar, over a full circle from -pi.
        speed: m/s.
        turn_rate: rad/s.
        mount: Mount of the lidar, in tf_static.
        more: Called every 0.05 s with the writer, the time and the pose.
        options: ``without``: names of what is left out; ``scan``: fields of the scans; ``change``:
            function of the ranges; ``turn``: quaternion of the mount in tf, ``told``: its pose;
            ``every``: steps of 0.05 s between scans; ``pose_qos``.
    """
    without, change = options.get("without", ()), options.get("change", lambda ranges: ranges)
    file = folder / ("drive.bag" if form == "ros1" else f"drive_{form}")
    writer = Writer(file, form)
    bearings = -math.pi + 2 * math.pi / num_beams * np.arange(num_beams)
    x = y = yaw = 0.0
    told, every = options.get("told", mount), options.get("every", 2)
    if "tf" not in without:
        writer.frame(START_S, "base_link", "laser", told, options.get("turn"), is_static=True)
    if "path" not in without:
        writer.path(START_S, [(0.05 * k, 0.0) for k in range(101)])
    for k in range(round(duration_s / 0.05)):
        time = START_S + 0.05 * k
        if "odometry" not in without:
            writer.odometry(time, (x + 3.0, y, yaw), speed, turn_rate)
        if k % 4 == 0 and "pose" not in without:
            writer.located(time, (x, y, yaw), options.get("pose_qos", "latched"))
        if k % every == 0:
            cos, sin = math.cos(yaw), math.sin(yaw)
            at = (x + cos * mount[0] - sin * mount[1], y + sin * mount[0] + cos * mount[1])
            ranges = change(room((*at, yaw + mount[2]), bearings))
            writer.scan("/scan", time, "laser", ranges, **options.get("scan", {}))
        if "command" not in without:
            writer.write("/cmd_vel", writer.twist(speed, turn_rate), time)
        if more is not None:
            more(writer, time, (x, y, yaw))
        x, y = x + 0.05 * speed * math.cos(yaw), y + 0.05 * speed * math.sin(yaw)
        yaw += 0.05 * turn_rate
    writer.close()
    return file


def carmen(file: Path, num_scans: int = 20, kind: str = "ROBOTLASER1") -> Path:
    """Write a CARMEN log of the same room: 180 degrees, 0.2 s apart, no return in the last beam."""
    lines = ["# CARMEN Logfile", "PARAM robot_frontlaser_offset 0.1 1 host 1"]
    bearings = np.radians(np.arange(180) - 90.0)
    for k in range(num_scans):
        x, time = 0.1 * k, 1000.0 + 0.2 * k
        ranges = room((x + 0.1, 0.0, 0.0), bearings)
        ranges[-1] = 81.83
        listed = " ".join(f"{value:.2f}" for value in ranges)
        end = f"{time:.3f} host {0.2 * k:.3f}"
        if kind == "FLASER":
            places = f"{x + 0.1:.3f} 0.0 0.0 {x:.3f} 0.5 0.0"
            lines += [
                f"ODOM {x:.3f} 0.5 0.0 0.5 0.0 0.0 {end}",
                f"FLASER 180 {listed} {places} {end}",
            ]
        else:
            angles = "0 -1.570796 3.141593 0.017453 81.0 0.1 0"
            places = f"{x + 0.1:.3f} 0.0 0.0 {x:.3f} 0.0 6.283185 0 0 0 0 0"
            lines.append(f"ROBOTLASER1 {angles} 180 {listed} 0 {places} {end}")
    file.write_text("\n".join(lines) + "\n")
    return file
