"""Bags of ROS 1 and ROS 2, read by rosbags without ROS."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from navrl.deploy.bags.decoders import DECODERS
from navrl.deploy.bags.messages import Logged, Topic
from navrl.deploy.ros_bridge import Message
from navrl.extras import require
from navrl.untrusted import DamagedFileError

_REMEDY = "rosbag reindex (ROS 1), ros2 bag reindex or mcap recover (ROS 2) may repair it"
_NANOSECONDS = 1e9  # of a second
_MAX_REASON = 150  # characters; rosbags quotes a whole definition


class RosLog:
    """Bag of ROS 1, or of ROS 2 as SQLite or MCAP.

    Args:
        file: ``.bag``, ``.db3`` or ``.mcap`` file, or the folder of a ROS 2 bag.

    Raises:
        ModuleNotFoundError: If the extra ``bags`` is not installed.
        DamagedFileError: If the bag cannot be read.
    """

    def __init__(self, file: str | Path) -> None:
        """Open the bag and list its topics."""
        require("bags", "a bag", "rosbags")
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.file = Path(file)
        # Bags of Humble and before have no definitions; the messages read here did not change.
        known = get_typestore(Stores.ROS2_HUMBLE)
        try:
            self._reader = AnyReader([self.file], default_typestore=known)
            self._reader.open()
            self.topics = {name: _topic(name, info) for name, info in self._reader.topics.items()}
        except Exception as error:  # rosbags passes on errors of struct, apsw, lz4, ...
            raise DamagedFileError(
                self.file, f"damaged or not a bag ({_reason(error)})", _REMEDY
            ) from error

    def messages(self, topics: Collection[str]) -> Iterator[Logged]:
        """Yield the messages of some topics in the order of their reception.

        Raises:
            DamagedFileError: If a message is damaged; one line with file and place.
        """
        chosen = [each for each in self._reader.connections if each.topic in topics]
        if not chosen:
            return
        rows, place = self._reader.messages(chosen), "first message"
        while True:
            try:
                row = next(rows, None)
                if row is None:
                    return
                connection, time, data = row
                place = f"{connection.topic}, message at {time / _NANOSECONDS:.3f} s"
                message = self._reader.deserialize(data, connection.msgtype)
                decoded = DECODERS[connection.msgtype][1](
                    message, connection.topic, time / _NANOSECONDS
                )
            except Exception as error:
                raise DamagedFileError(
                    self.file, f"{place}: damaged ({_reason(error)})", _REMEDY
                ) from error
            place = f"after {place}"
            yield decoded

    def close(self) -> None:
        """Close the bag."""
        self._reader.close()


def _topic(name: str, info: Message) -> Topic:
    kind = DECODERS.get(info.msgtype, (None, None))[0]
    policies = [
        profile
        for connection in info.connections
        for profile in getattr(connection.ext, "offered_qos_profiles", ())
    ]
    first = policies[0] if policies else None
    latched = any(getattr(connection.ext, "latching", None) for connection in info.connections)
    return Topic(
        name,
        kind,
        info.msgtype or "several types",
        info.msgcount,
        first and first.reliability.name.lower(),
        first.durability.name.lower() if first else "transient_local" if latched else None,
    )


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text.rstrip(".")[:_MAX_REASON]
