"""Paths to goals on a map, planned while the robot is stationary."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Sequence

import numpy as np

from navrl.deploy.controller import Controller
from navrl.deploy.safety import DriveState
from navrl.worlds.places.occupancy_map import Message, OccupancyMap

_LOG = logging.getLogger(__name__)
MARGIN_M = 0.05  # m between hull and obstacles on a path


class MapPlanner:
    """Planner of a controller's paths: map and goals in, paths out.

    A goal first cancels the path of the controller. As soon as a tick has stopped the robot, the
    path is planned in a thread, since it takes up to seconds on large maps. A goal that cannot be
    reached leaves the robot without a path, and :attr:`reason` says why.

    :meth:`set_map` and :meth:`set_goal` may be called from any thread; call :meth:`poll` after each
    tick, in the same thread.

    Args:
        control: Controller that follows the paths.
        robot_radius: Of the hull, m; ``None`` for that of the policy's robot.
        occupied_percent: Smallest value of an occupied cell of a message.
        free_percent: Largest value of a free cell of a message.
        on_path: Called by :meth:`poll` with each new path ``[P, 2]`` m.

    Attributes:
        reason: Why there is no path to the last goal; empty if there is one, or no goal yet.
        is_refused: Whether the last goal cannot be reached, instead of being planned.

    Raises:
        ValueError: If the radius is not positive.

    Example:
        >>> from navrl.policies import ZOO
        >>> control = Controller.from_bundle(ZOO / "paper")
        >>> planner = MapPlanner(control)
        >>> values = np.zeros((100, 60), dtype=np.int8)  # 5 m x 3 m
        >>> planner.set_map(OccupancyMap(values, 0.05, np.zeros(3)))
        >>> planner.set_goal((4.0, 1.5))
        >>> control.on_pose(0.0, (1.0, 1.5, 0.0))
        >>> str(control.tick(0.0).state)
        'no_path'
        >>> planner.poll()  # starts to plan
        >>> planner.wait()
        >>> planner.poll()
        >>> str(control.tick(0.1).state)  # a path, but no scan
        'stale_scan'
    """

    def __init__(
        self,
        control: Controller,
        robot_radius: float | None = None,
        occupied_percent: float = 65.0,
        free_percent: float = 25.0,
        on_path: Callable[[np.ndarray], object] | None = None,
    ) -> None:
        """Store the arguments."""
        radius = float(control.runner.robot.radius) if robot_radius is None else robot_radius
        if not 0.0 < radius < math.inf:
            raise ValueError(f"robot_radius={radius}: must be > 0 m")
        self.control, self.clearance = control, radius + MARGIN_M
        self.thresholds = (occupied_percent, free_percent)
        self.on_path = on_path
        self.reason, self.is_refused = "", False
        self._lock = threading.Lock()
        self._given: Message = None  # the last map or message
        self._map: tuple[Message, OccupancyMap] | None = None  # what it was read from, and the map
        self._goal: tuple[float, float] | None = None  # not yet planned
        self._thread: threading.Thread | None = None
        self._result: tuple[tuple[float, float], np.ndarray | None, str] | None = None

    def set_map(self, given: Message) -> None:
        """Store an :class:`OccupancyMap` or a nav_msgs/OccupancyGrid for the next goals."""
        with self._lock:
            self._given = given

    def set_goal(self, goal: Sequence[float]) -> None:
        """Cancel the path and store a new goal (x, y), m in the frame of the map."""
        x, y = goal
        with self._lock:
            self._goal = (float(x), float(y))
            self.reason, self.is_refused = f"goal=[{x:.2f}, {y:.2f}]: waits for a tick", False
        self.control.on_path(None)

    def refuse(self, reason: str) -> None:
        """Cancel the path and store why the last goal is refused."""
        with self._lock:
            self._goal = None
            self.reason, self.is_refused = reason, True
        self.control.on_path(None)

    def poll(self) -> None:
        """Start to plan if a goal waits and the robot is stationary; hand over a planned path."""
        if self._thread is not None:
            if not self._thread.is_alive():
                self._thread = None
                self._finish()
            return
        with self._lock:
            goal, given, status = self._goal, self._given, self.control.status
            if goal is None:
                return
            missing = self._missing()
            self.reason = f"goal=[{goal[0]:.2f}, {goal[1]:.2f}]: {missing or 'is planned'}"
        if missing or status is None or status.pose is None:
            return
        arguments = (goal, given, status.pose[:2].copy())
        self._thread = threading.Thread(target=self._plan, args=arguments, daemon=True)
        self._thread.start()

    def wait(self, timeout_s: float = 60.0) -> None:
        """Wait until planning ends, at most for a time, s."""
        if self._thread is not None:
            self._thread.join(timeout_s)

    def _missing(self) -> str:
        """Return what planning waits for; empty for nothing."""
        status = self.control.status
        if self._given is None:
            return "waits for a map"
        if status is None or status.state is DriveState.DRIVE:
            return "waits for a tick"
        if status.pose is None or not status.pose_age_s <= self.control.limits.pose_timeout_s:
            return "waits for a pose"
        return ""

    def _plan(self, goal: tuple[float, float], given: Message, start: np.ndarray) -> None:
        try:
            path, reason = self._read(given).path(start, goal, self.clearance), ""
        except ValueError as error:
            path, reason = None, str(error)
        except Exception as error:
            _LOG.exception("the planner failed; the robot has no path")
            path, reason = None, f"{type(error).__name__}: {error}"
        self._result = (goal, path, reason)

    def _read(self, given: Message) -> OccupancyMap:
        """Return the map of a message; the last one is retained."""
        if isinstance(given, OccupancyMap):
            return given
        if self._map is None or self._map[0] is not given:
            try:
                self._map = (given, OccupancyMap.from_message(given, *self.thresholds))
            except ValueError as error:
                raise ValueError(f"map: {error}") from error
        return self._map[1]

    def _finish(self) -> None:
        """Give a planned path to the controller, unless there is a newer goal."""
        assert self._result is not None  # the thread has ended
        goal, path, reason = self._result
        with self._lock:
            if goal is not self._goal:
                return
            self._goal = None
            self.reason, self.is_refused = reason, path is None
            if path is not None:
                self.control.on_path(path)
        if path is not None and self.on_path is not None:
            self.on_path(path)
        if path is None:
            _LOG.warning("%s", reason)
