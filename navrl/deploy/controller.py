"""Control loop of a robot without transport: from stamped inputs to commands."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike

from navrl.deploy.control_limits import ControlLimits
from navrl.deploy.control_status import Command, ControlStatus, observed
from navrl.deploy.robot_inputs import RobotInputs
from navrl.deploy.runner import PolicyRunner
from navrl.deploy.safety import DriveState, SafetyLimits
from navrl.deploy.scan_adapter import adapt_scan, load_scanner
from navrl.ops.scanner import Scanner

_LOG = logging.getLogger(__name__)
_EARLY = 0.1  # share of the time step by which a scan may come early
_CLOCK_RESET_S = 1.0  # a clock that goes back by more has restarted, as in a simulation


class Controller:
    """Control loop of a robot along paths, from stamped inputs to commands.

    Call ``on_...`` with each input and :meth:`tick` at a fixed rate; times are seconds of the
    caller's clock. A tick returns zero in every state but ``DRIVE``. The policy decides once per
    time step of its training: of a faster lidar, scans are skipped, and after a gap the history
    restarts. Between two decisions the last command is repeated, within the limits of acceleration.

    Every method may be called from any thread. The ``on_...`` methods and :meth:`emergency_stop`
    only store a value and do not wait for a decision; a tick waits for a tick of another thread.
    Every tick that begins after :meth:`emergency_stop`, and one that is deciding meanwhile, returns
    zero. Send the command from the thread that ticks, so that an earlier one cannot follow later.

    Args:
        runner: The policy, of a base with commands (v, w). It must not be used elsewhere.
        scanner: Mount and readings of the robot's lidar; angles and limits come with each scan or
            are those of the scanner. ``None`` for a lidar at the robot's center.
        limits: Timeouts, and limits of speed and acceleration.
        compensate_motion: Whether a scan is moved to the time of the tick, by odometry or, without
            it, by the commands since.

    Attributes:
        status: :class:`ControlStatus` after the last tick; ``None`` before the first one.

    Raises:
        ValueError: If the policy's commands are not (v, w).

    Example:
        >>> from navrl.policies import ZOO
        >>> control = Controller.from_bundle(ZOO / "paper", scanner=load_scanner("rplidar_a1"))
        >>> control.on_path([(0.1 * i, 0.0) for i in range(41)])
        >>> control.on_pose(10.0, (0.0, 0.0, 0.0))
        >>> control.on_scan(9.8, np.full(360, 2.0))
        >>> v, w, state = control.tick(10.0)
        >>> bool(v > 0.0), str(state)
        (True, 'drive')
        >>> control.tick(11.0)  # no scan for a second
        Command(v=0.0, w=0.0, state=<DriveState.STALE_SCAN: 'stale_scan'>)
    """

    def __init__(
        self,
        runner: PolicyRunner,
        scanner: Scanner | None = None,
        limits: ControlLimits | None = None,
        compensate_motion: bool = True,
    ) -> None:
        """Check and store the arguments."""
        if runner.robot.command_size != 2:
            raise ValueError(
                f"runner: must be of a base with commands (v, w), got {runner.robot.command_size}"
            )
        self.runner = runner
        self.limits = ControlLimits() if limits is None else limits
        self.compensate_motion = compensate_motion
        step = self.limits.max_step_s
        self.max_step_s = 2.0 * runner.time_step_s if step is None else step
        self._inputs = RobotInputs(Scanner() if scanner is None else scanner)
        self._lock, self._tick_lock = threading.Lock(), threading.Lock()
        self._is_stopped = self._has_arrived = False
        self._counts = {"num_steps": 0, "num_thinned": 0, "num_rejected": 0, "num_resets": 0}
        self._used_stamp = self._now = -math.inf
        self._path_count = 0
        self._wanted, self._last = (0.0, 0.0), (0.0, 0.0)
        self._decision, self._reason = DriveState.STALE_SCAN, ""
        self.status: ControlStatus | None = None

    @classmethod
    def from_bundle(
        cls,
        folder: str | Path,
        scanner: Scanner | str | None = None,
        limits: ControlLimits | None = None,
        compensate_motion: bool = True,
        safety: SafetyLimits | None = None,
        **arguments: Any,
    ) -> Controller:
        """Load a bundle; folder, ``safety`` and further arguments are those of the runner's."""
        runner = PolicyRunner.from_bundle(folder, limits=safety, **arguments)
        device = load_scanner(scanner) if isinstance(scanner, str) else scanner
        return cls(runner, device, limits, compensate_motion)

    def warm_up(self, count: int = 3) -> None:
        """Make ``count`` decisions on an artificial scan, since the first ones are slow."""
        with self._tick_lock:
            ranges = np.full(self.runner.num_beams, 2.0)
            motion, lidar = np.zeros((2, 3)), self.runner.lidar
            own = Scanner(lidar.angle_min, lidar.angle_increment, lidar.mount)
            for _ in range(count):
                adapt_scan(ranges, own, lidar, motion)
                self.runner.act(ranges, (0.0, 0.0, 0.0), [(0.0, 0.0), (4.0, 0.0)], (0.0, 0.0))
            self.runner.reset()
            self._used_stamp = -math.inf

    def on_scan(
        self,
        stamp: float,
        ranges: ArrayLike,
        angle_min: float | None = None,
        angle_increment: float | None = None,
        range_min: float | None = None,
        range_max: float | None = None,
        duration_s: float | None = None,
    ) -> None:
        """Store a scan.

        Args:
            stamp: Time of the first beam, s.
            ranges: ``[M]`` m, any number of beams.
            angle_min: This and the angle increment as in :class:`Scanner`, None for the scanner's.
            angle_increment: rad, negative for clockwise order.
            range_min: Smallest distance, m; as ``range_max`` it only narrows the scanner's.
            range_max: m.
            duration_s: Time from the first to the last beam, s; None for the scanner's.

        Raises:
            ValueError: If a value is invalid. The last scan is dropped too, so the robot stops.
        """
        limits = (angle_min, angle_increment, range_min, range_max)
        with self._storing():
            waiting = self._inputs.scan
            is_new = self._inputs.set_scan(stamp, ranges, limits, duration_s)
            if is_new and waiting is not None and waiting.stamp > self._used_stamp:
                self._counts["num_thinned"] += 1
            self._counts["num_rejected"] += not is_new

    def on_odometry(self, stamp: float, pose: ArrayLike, velocity: ArrayLike) -> None:
        """Store odometry, in a frame that does not jump.

        Args:
            stamp: Time of the measurement, s.
            pose: ``[3]`` (x, y, yaw), m and rad.
            velocity: ``[2]`` (v, w), m/s and rad/s.

        Raises:
            ValueError: If a value is invalid. The robot stops until the next valid odometry.
        """
        with self._storing():
            is_new = self._inputs.set_odometry(stamp, pose, velocity)
            self._counts["num_rejected"] += not is_new

    def on_pose(self, stamp: float, pose: ArrayLike) -> None:
        """Store the robot's pose in the frame of the path.

        Raises:
            ValueError: If a value is invalid. The last pose is dropped too, so the robot stops.
        """
        with self._storing():
            is_new = self._inputs.set_pose(stamp, pose)
            self._counts["num_rejected"] += not is_new

    def on_path(self, path: ArrayLike | None) -> None:
        """Store a new path; the scan history is retained.

        Args:
            path: ``[P, 2]`` m, any number of points; ``None`` to cancel the drive.

        Raises:
            ValueError: If the path is invalid. The last path is dropped too, so the robot stops.
        """
        with self._storing():
            self._has_arrived = False
            self._inputs.set_path(path)

    def emergency_stop(self) -> None:
        """Stop the robot until :meth:`release`."""
        self._is_stopped = True  # first without the lock: a tick that ends now reads it
        with self._lock:
            self._is_stopped, self._last = True, (0.0, 0.0)

    def release(self) -> None:
        """Release the emergency stop."""
        with self._lock:
            self._is_stopped = False

    @contextmanager
    def _storing(self) -> Iterator[None]:
        """Hold the lock and count what is rejected with an error."""
        with self._lock:
            try:
                yield
            except Exception:
                self._counts["num_rejected"] += 1
                raise

    def tick(self, now: float) -> Command:
        """Return the command that applies until the next tick.

        Args:
            now: Time, s; ticks in its past restart the controller, as a simulation does.

        Returns:
            (v, w, state), zero unless the state is ``DRIVE``; of a time that is not finite, too.

        Raises:
            ValueError: If ``now`` is not a number.
        """
        if not isinstance(now, SupportsFloat):
            raise ValueError(f"now={now!r}: must be a number (s)")
        with self._tick_lock:
            with self._lock:
                duration = self._advance_clock(now)
                state, reason = self._input_state(now)
                job = self._next_step(now) if state is DriveState.DRIVE else None
            if job is not None:
                self._decide(job)
            with self._lock:
                if state is DriveState.DRIVE:
                    state, reason = self._decision, self._reason
                    self._has_arrived |= job is not None and state is DriveState.AT_GOAL
                if self._is_stopped:
                    state, reason = DriveState.EMERGENCY_STOP, "emergency stop"
                if state is DriveState.DRIVE:
                    self._last = self.limits.limited(self._wanted, self._last, duration)
                else:  # a stop holds until the next decision
                    self._wanted = self._last = (0.0, 0.0)
                command = Command(*self._last, state)
                self.status = self._report(now, command, reason)
            return command

    def _advance_clock(self, now: float) -> float:
        """Return the time since the last tick, s, and integrate the last command since then."""
        if not math.isfinite(now):
            return 0.0
        if now < self._now - _CLOCK_RESET_S:
            self._inputs.clear()
            self.runner.reset_scans()
            self._used_stamp, self._now, self._last = -math.inf, now, (0.0, 0.0)
        duration = min(max(now - self._now, 0.0), self.max_step_s)
        self._now = max(now, self._now)
        ahead = self._inputs.drop_future(now, self.limits.max_clock_skew_s)
        self._counts["num_rejected"] += ahead
        self._inputs.advance(now, self._last, duration)
        return duration

    def _input_state(self, now: float) -> tuple[DriveState, str]:
        """Return the state that follows from the inputs; ``DRIVE`` if the policy may decide."""
        if self._is_stopped:
            return DriveState.EMERGENCY_STOP, "emergency stop"
        state, reason = self._inputs.state(now, self.limits)
        if state is DriveState.DRIVE and self._has_arrived:
            return DriveState.AT_GOAL, "at the goal until a new path"
        return state, reason

    def _next_step(self, now: float) -> tuple[Any, ...] | None:
        """Return the arguments of :meth:`_decide` if a decision is due."""
        inputs, scan = self._inputs, self._inputs.scan
        assert scan is not None and inputs.path is not None  # see _input_state
        elapsed = scan.stamp - self._used_stamp
        if elapsed < (1.0 - _EARLY) * self.runner.time_step_s:
            return None
        if math.isfinite(self._used_stamp) and elapsed > self.max_step_s + 1e-6:
            self._counts["num_resets"] += 1
            self.runner.reset_scans()
        self._used_stamp = scan.stamp
        if self._path_count != inputs.path_count:
            self._path_count = inputs.path_count
            self.runner.new_path()
        motion = inputs.scan_motion(now) if self.compensate_motion else None
        velocity = inputs.motion.velocity if len(inputs.motion) else self._last
        return scan, motion, inputs.pose_at(now), inputs.path, velocity, self._last

    def _decide(self, step: tuple[Any, ...]) -> None:
        """Run the policy; without the lock, so that inputs do not wait."""
        scan, motion, pose, path, velocity, last = step
        self._counts["num_steps"] += 1
        try:
            adapted = adapt_scan(scan.ranges, scan.scanner, self.runner.lidar, motion)
            command = self.runner.act(adapted.ranges, pose, path, velocity, command=last)
            state = self.runner.state
            assert state is not None  # act returned
            self._decision, self._wanted = state, (float(command[0]), float(command[1]))
            self._reason = "" if state is DriveState.DRIVE else str(state)
        except Exception as error:
            _LOG.exception("the policy failed; the robot stops")
            self._decision, self._wanted = DriveState.BAD_COMMAND, (0.0, 0.0)
            self._reason = f"{type(error).__name__}: {error}"

    def _report(self, now: float, command: Command, reason: str) -> ControlStatus:
        inputs = self._inputs
        return ControlStatus(
            stamp=now,
            command=command,
            reason=reason,
            scan_age_s=inputs.scan_age(now),
            pose_age_s=inputs.pose_age(now)[0],
            pose=inputs.pose_at(now),
            goal_distance_m=inputs.goal_distance(now),
            **self._counts,
            **observed(self.runner.observation),
        )
