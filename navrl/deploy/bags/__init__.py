"""Logs of robots: bags and logs of CARMEN, read without ROS, and live topics."""

from navrl.deploy.bags.carmen_log import CarmenLog
from navrl.deploy.bags.frames import FrameTree, Placed, homogeneous
from navrl.deploy.bags.live_topics import LIVE, LiveLog, listen
from navrl.deploy.bags.messages import (
    FrameTransform,
    Log,
    Logged,
    LoggedCommand,
    LoggedOdometry,
    LoggedPath,
    LoggedPose,
    LoggedScan,
    LoggedTransforms,
    Topic,
)
from navrl.deploy.bags.opening import choose_scans, choose_topic, open_log
from navrl.deploy.bags.ros_log import RosLog
from navrl.deploy.bags.sources import LogSource, Topics

__all__ = [
    "LIVE",
    "CarmenLog",
    "FrameTransform",
    "FrameTree",
    "LiveLog",
    "Log",
    "LogSource",
    "Logged",
    "LoggedCommand",
    "LoggedOdometry",
    "LoggedPath",
    "LoggedPose",
    "LoggedScan",
    "LoggedTransforms",
    "Placed",
    "RosLog",
    "Topic",
    "Topics",
    "choose_scans",
    "choose_topic",
    "homogeneous",
    "listen",
    "open_log",
]
