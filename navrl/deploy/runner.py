"""Runner that maps a scan, a pose and a path to a command for one robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.envs import ActionScaling, Transform, TransformedEnv

from navrl import keys
from navrl.checks import check_positive, checked_numbers, checked_pose
from navrl.deploy.actor_call import ActorCall
from navrl.deploy.paths import checked_path, start_progress
from navrl.deploy.safety import (
    DriveState,
    SafetyLimits,
    ScanCheck,
    path_state,
    safe_command,
)
from navrl.deploy.sensor_env import SensorEnv, checked_rows, read_keys, steps_of
from navrl.policies import load_bundle
from navrl.policies.classical.commands import normalized_action
from navrl.policies.names import bundle_folder
from navrl.sim import Delays, Lidar, RobotModel
from navrl.transforms import Base, StallTimer, Waypoints
from navrl.transforms.min_pool import check_lidar
from navrl.worlds.scenario import MAX_PATH_POINTS

_OF_VELOCITY = {keys.VELOCITY, keys.VELOCITY_AHEAD, keys.MOTION_AHEAD}


class PolicyRunner:
    """Run a policy on a robot, with one call per scan.

    Commands equal those of the same policy at the same place in simulation; the scan history is
    stored between calls. Only torch and the transforms run, without simulator or environment. If
    the scan is unusable, the goal is reached or the path is too far away, the command is zero;
    :attr:`state` is the reason.

    Args:
        transforms: Map raw observations to network inputs, as in training. They are cloned, so that
            they can be shared by several runners.
        actor: Writes an action in [-1, 1].
        lidar: Lidar of the training: number of beams, maximum range and mount.
        robot: Limits of the command.
        delays: Delays of scans and commands, for policies that predict their motion and shields
            that know the base; ``None`` for none.
        time_step_s: Time between two calls of :meth:`act`, s, to which the delays relate.
        limits: Conditions under which the robot may drive; defaults of :class:`SafetyLimits`.

    Attributes:
        state: :class:`DriveState` after the last call of :meth:`act`; ``None`` before the first one
            and after one that raised.
        transform: The transforms with the scaling of the action, clones of the arguments.

    Raises:
        ValueError: If the transforms do not fit the lidar; the message names the transform.

    Example:
        >>> from navrl.policies import ZOO
        >>> runner = PolicyRunner.from_bundle(ZOO / "paper")
        >>> command = runner.act(np.full(1440, 2.0), pose=(0.0, 0.0, 0.0), path=[(0, 0), (4, 0)])
        >>> bool(0.0 <= command[0] <= 1.0)
        True
        >>> runner.act(np.full(1440, np.inf), (0.0, 0.0, 0.0), [(0, 0), (4, 0)]).tolist()
        [0.0, 0.0]
        >>> print(runner.state)
        blind
    """

    def __init__(
        self,
        transforms: Transform,
        actor: TensorDictModule,
        lidar: Lidar,
        robot: RobotModel,
        limits: SafetyLimits | None = None,
        delays: Delays | None = None,
        time_step_s: float = 0.2,
    ) -> None:
        check_positive(time_step_s=time_step_s)
        check_lidar(transforms, lidar)
        self.lidar, self.robot = lidar, robot
        self.num_beams, self.max_range = lidar.num_beams, lidar.max_range
        self._has_blind_beams = not lidar.coverage.is_full
        self.limits = SafetyLimits() if limits is None else limits
        self.state: DriveState | None = None
        delays = Delays() if delays is None else delays
        self._base = Base(robot, delays.nominal_command_delays_s, delays.nominal_scan_age_s)
        senses = TransformedEnv(SensorEnv(lidar, self._base), transforms.clone())
        senses.append_transform(ActionScaling())
        senses.action_spec  # noqa: B018, reports a mismatch now instead of at the first scan
        self._env, self.transform = senses, senses.transform
        self._act, self._robot = ActorCall(actor), robot
        self._stop = normalized_action(robot, torch.zeros(1, robot.command_size))
        self._scan_check = ScanCheck(lidar, robot, self.limits)
        self._past: TensorDictBase | None = None
        self._waypoint_steps = steps_of(transforms, Waypoints)
        self._stall_timers = steps_of(transforms, StallTimer)
        self._progress: float | None = None  # m, at which the next observation starts
        self._has_new_path = False
        self.time_step_s = float(time_step_s)
        steps = math.ceil(max(self._base.command_delays_s) / self.time_step_s)
        self._given = torch.zeros(1, max(1, steps), robot.command_size)  # latest first
        self._needs_velocity = not _OF_VELOCITY.isdisjoint(read_keys(transforms))

    @classmethod
    def from_bundle(
        cls,
        folder: str | Path,
        allow: Sequence[str] = (),
        limits: SafetyLimits | None = None,
        delays: Delays | None = None,
        with_attention: bool = False,
    ) -> PolicyRunner:
        """Load a bundle: one of the zoo, or that of a training run.

        Args:
            folder: Folder of the bundle or training run, or a name of the zoo, e.g. ``paper``.
            allow: See :func:`navrl.policies.load_bundle`.
            limits: See :class:`PolicyRunner`.
            delays: See :class:`PolicyRunner`.
            with_attention: Whether :attr:`observation` has the attention weights.

        Raises:
            BundleError: If the bundle is damaged or not allowed.
        """
        bundle = load_bundle(bundle_folder(str(folder)) or folder, allow)
        transforms, lidar, robot = map(bundle.build, ("transforms", "lidar", "robot"))
        actor = bundle.actor_with_attention() if with_attention else bundle.actor
        return cls(
            transforms, actor, lidar, robot, limits, delays, bundle.config.get("time_step_s", 0.2)
        )

    def reset(self) -> None:
        """Clear the scan history: the next scan is the first of a new drive."""
        self._past = self._progress = None
        self._has_new_path = False
        self._given = torch.zeros_like(self._given)

    def new_path(self) -> None:
        """Start another path with the next scan; the scan history is retained.

        Where the path passes the robot more than once, the robot starts on the first branch.
        """
        self._has_new_path = True

    def reset_scans(self) -> None:
        """Clear the scan history after a gap between scans; the progress is retained."""
        if self._past is not None and self._waypoint_steps and not self._has_new_path:
            self._progress = float(self._past.get(self._waypoint_steps[0].out_keys[1]))
        self._past = None

    @property
    def observation(self) -> TensorDictBase | None:
        """Keys of the last decision ``[1, ...]``, attention included; ``None`` after a reset."""
        return self._past

    @torch.no_grad()
    def act(
        self,
        ranges: ArrayLike,
        pose: ArrayLike,
        path: ArrayLike,
        velocity: ArrayLike | None = None,
        scan_motion: ArrayLike | None = None,
        command: ArrayLike | None = None,
    ) -> np.ndarray:
        """Return the command for one scan.

        Args:
            ranges: ``[num_beams]`` m, beam j at bearing ``2 pi j / num_beams``, counted
                counter-clockwise from the lidar's x axis: straight ahead unless the policy's
                ``lidar.mount`` is turned. A beam without return reads at least the lidar's
                ``max_range``, infinity or zero; one that is too close to be measured reads negative
                infinity; NaN and other negative values are invalid (:class:`ScanCheck`). Beams
                outside of the robot's field of view read NaN; those that are blind in the policy's
                lidar may read anything.
            pose: ``[3]`` (x, y, yaw) m and rad, in the frame of ``path``.
            path: ``[P, 2]`` m, from about the robot to the goal, at most 200 points. Call
                :meth:`new_path` when it changes, since progress along it is stored.
            velocity: ``[C]`` the robot's velocity now, e.g. (v, w) of its odometry, m/s and rad/s;
                required by policies that read it.
            scan_motion: ``[2, 3]`` (x, y, yaw) m and rad of the robot at the times of the scan's
                first and last beam, in its present frame, from odometry; ``None`` for a scan
                without age.
            command: ``[C]`` the command that the robot was given last, if it was not the one that
                the last call returned, m/s and rad/s.

        Returns:
            ``[C]`` float32 within the robot's limits, e.g. (v, w) in m/s and rad/s; valid until the
            next scan, 0.2 s later in training. Zero unless :attr:`state` is ``DRIVE``. Observations
            are not stored in the states ``BLIND``, ``OFF_PATH`` and ``BAD_COMMAND``; the stop is
            stored as the last action.

        Raises:
            ValueError: If a shape does not fit, if pose, path, velocity, motion or command is not
                finite, if the policy needs a velocity that is not given, or if the yaw is not in
                radians. The stored history is unchanged then.
        """
        self.state = None  # until a decision is made
        sensed = self._checked(ranges, pose, path)
        sensed.update(self._checked_motion(velocity, scan_motion, command))
        answer, self.state = self._decide(sensed, self._sensed_state(ranges, pose, path))
        if answer is not None and self.state is DriveState.DRIVE:
            self._give(torch.from_numpy(answer.copy()))
            return answer
        self._give(torch.zeros(self._robot.command_size))
        if self._past is not None:  # controllers read the action that was driven, which is a stop
            self._past = self._past.copy().set(keys.ACTION, self._stop.clone())
        return np.zeros(self._robot.command_size, dtype=np.float32)

    def _give(self, command: Tensor) -> None:
        """Store the command of this step as the latest."""
        self._given = torch.cat((command[None, None], self._given[:, :-1]), dim=1)

    def _decide(
        self, sensed: TensorDictBase, state: DriveState
    ) -> tuple[np.ndarray | None, DriveState]:
        """Return the policy's command and the state; update the history if both are usable."""
        if state in (DriveState.BLIND, DriveState.OFF_PATH):
            return None, state
        now = self._observe(sensed)
        answer = self._act(now)
        action = answer.pop(keys.ACTION)
        command = self.transform.inv(now.copy().set(keys.ACTION, action)).get(keys.ACTION)
        command = safe_command(command[0].numpy(), self._robot)
        if command is None:
            return None, DriveState.BAD_COMMAND
        self._past = now.set(keys.ACTION, action).update(answer)
        self._progress, self._has_new_path = None, False
        return command, state

    def _observe(self, sensed: TensorDictBase) -> TensorDictBase:
        """Map the sensed values; a new path, and a drive after a gap, start at their progress."""
        past, start = self._past, self._progress
        if self._has_new_path:
            path, pose = sensed.get(keys.PATH)[0], sensed.get(keys.POSE)[0]
            start = start_progress(path.numpy(), pose[:2].numpy())
        if past is None:
            past = self.transform._reset(sensed.copy(), sensed.copy())
            if start is None or not self._waypoint_steps:
                return past
        if start is not None:
            past = past.copy()
            for step in (*self._stall_timers, *self._waypoint_steps):
                step.restart(past, torch.tensor([[start]]))
        now = self.transform._step(past, sensed)
        return now.update(self._act.passed_on(past))

    def _sensed_state(self, ranges: ArrayLike, pose: ArrayLike, path: ArrayLike) -> DriveState:
        """Return the state that follows from scan, pose and path."""
        seen = self._scan_check.state(_single(ranges))
        if seen is DriveState.BLIND:
            return seen
        pose, path = (np.asarray(value, dtype=np.float64) for value in (pose, path))
        place = path_state(pose, path, self.limits)
        return seen if place is DriveState.DRIVE else place

    def _checked_motion(
        self,
        velocity: ArrayLike | None,
        scan_motion: ArrayLike | None,
        command: ArrayLike | None,
    ) -> dict[str, Tensor]:
        if velocity is None and self._needs_velocity:
            raise ValueError("velocity=None: must be the robot's velocity, this policy reads it")
        size = self._robot.command_size
        values = checked_rows(
            {
                keys.VELOCITY: (velocity, (size,)),
                keys.COMMAND: (self._given[0, 0].numpy() if command is None else command, (size,)),
                keys.SCAN_MOTION: (scan_motion, (2, 3)),
            }
        )
        self._given[:, 0] = values[keys.COMMAND]
        ahead = self._base.ahead(values[keys.VELOCITY], self._given, self.time_step_s)
        values[keys.MOTION_AHEAD], values[keys.VELOCITY_AHEAD] = ahead
        return values

    def _checked(self, ranges: ArrayLike, pose: ArrayLike, path: ArrayLike) -> TensorDictBase:
        ranges = _single(ranges)
        # The transforms subtract pose and path in float64: float32 resolves large maps to 0.5 m.
        if ranges.shape != (self.num_beams,):
            raise ValueError(
                f"ranges.shape={list(ranges.shape)}: must be [{self.num_beams}]; "
                "navrl.deploy.adapt_scan reads the scans of other lidars"
            )
        pose, path = checked_pose("pose", pose), checked_path(path, MAX_PATH_POINTS)
        whole = np.concatenate([path, np.repeat(path[-1:], MAX_PATH_POINTS - len(path), axis=0)])
        measured = self._scan_check.usable(ranges)
        ranges = self._scan_check.cleaned(ranges)
        values = {keys.RANGES: ranges, keys.POSE: pose.copy(), keys.PATH: whole}
        if self._has_blind_beams:
            values[keys.MEASURED] = measured
        return TensorDict({k: torch.from_numpy(v).unsqueeze(0) for k, v in values.items()}, [1])


def _single(values: ArrayLike) -> np.ndarray:
    """Convert ranges to float32; too large values become infinite."""
    numbers = checked_numbers("ranges", values, "[beams] numbers (m)")
    with np.errstate(over="ignore"):
        return numbers.astype(np.float32)
