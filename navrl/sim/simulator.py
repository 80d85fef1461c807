"""Interface of simulators: robots in scenarios, controlled by commands, with a lidar.

It has two implementations: :class:`navrl.sim.BatchedSimulator` for speed and
:class:`navrl.sim.BulletSimulator` as the reference. The same scenario and commands result in the
same episode on both.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from navrl.checks import check_positive
from navrl.deprecation import warn
from navrl.ops.backend import find_device
from navrl.sim.crowd import PedestrianModel, ScriptedRoutes
from navrl.sim.delays import CommandQueue, Delays
from navrl.sim.lidar import Lidar
from navrl.sim.reset_checks import check_reset
from navrl.sim.robot import RobotModel
from navrl.sim.scan_memory import ScanMemory
from navrl.sim.state import SimState

if TYPE_CHECKING:
    from navrl.worlds import ScenarioBatch


class Simulator(ABC):
    """Base class of simulators of N independent worlds with one robot, walls and pedestrians.

    A step of ``time_step_s`` is divided into ``substeps``. At each substep the robot and the
    pedestrians are moved, then contacts are checked. A world freezes at its first contact (pose,
    pedestrians and clock) and reports that contact until it is reset. Without a reactive model, the
    positions of pedestrians are a closed-form function of time.

    Args:
        num_worlds: Number of worlds N.
        robot: Robot model: hull, command limits, motion.
        lidar: Lidar model; :meth:`ranges` has no noise, which the environment adds.
        time_step_s: Duration of one :meth:`step`, s.
        substeps: Contact checks per step.
        max_pedestrians: Number of rows K of :attr:`SimState.pedestrians`.
        pedestrians: Pedestrian model; None for the routes of the scenario.
        delays: Delays of scans and commands; None for no delays.
        device: Device of the outputs.

    Raises:
        ValueError: If a value is not positive and finite, a delay is not a multiple of the substep,
            or a requirement of ``device`` is missing.
    """

    _rows: dict[str, Tensor]  # state of the worlds; "pose" is [N, 3] float64

    def __init__(
        self,
        num_worlds: int,
        robot: RobotModel,
        lidar: Lidar,
        time_step_s: float,
        substeps: int,
        max_pedestrians: int,
        pedestrians: PedestrianModel | None,
        delays: Delays | None,
        device: torch.device | str = "cpu",
    ) -> None:
        check_positive(
            num_worlds=num_worlds,
            time_step_s=time_step_s,
            substeps=substeps,
            max_pedestrians=max_pedestrians,
        )
        self.num_worlds, self.max_pedestrians = int(num_worlds), int(max_pedestrians)
        self.time_step_s, self.substeps = float(time_step_s), int(substeps)
        self.substep_s = self.time_step_s / self.substeps
        self.robot, self.lidar = robot, lidar
        self.pedestrians = ScriptedRoutes() if pedestrians is None else pedestrians
        self.device = find_device(device)
        self.delays = delays = Delays() if delays is None else delays
        clock = (delays, self.substeps, self.substep_s)
        self.commands = CommandQueue(self.num_worlds, robot.command_size, *clock, self.device)
        drawn = robot.draw(torch.zeros(0, dtype=torch.int64, device=self.device))
        self.robot_parameters = drawn.new_zeros(self.num_worlds, drawn.shape[1])
        """[N, P] float64, parameters of the robot model in the current episodes."""
        coverage = min(1.0, lidar.num_beams * abs(lidar.increment) / (2.0 * math.pi))
        sizes = (self.num_worlds, self.max_pedestrians)
        self.scan_memory = ScanMemory(*sizes, delays, coverage, *clock[1:], self.device)

    @abstractmethod
    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        """Start scenario ``i`` in world ``worlds[i]``: stationary robot at the start, time zero.

        Other worlds do not change, bit for bit.

        Args:
            worlds: [M] int64, distinct world indices.
            scenarios: M scenarios with at most ``max_pedestrians`` pedestrians each.

        Raises:
            ValueError: If lengths differ, an index is out of range or repeated, or a scenario has
                more pedestrians than ``max_pedestrians``, an invalid wall or a start too far away.
        """

    @abstractmethod
    def step(self, command: Tensor) -> SimState:
        """Advance all worlds by ``time_step_s``.

        Args:
            command: [N, C], components of the robot model, e.g. (v, w) in m/s and rad/s; clipped
                to its limits.

        Returns:
            The state after the step.

        Raises:
            ValueError: If the shape is wrong or a value is not finite.
            RuntimeError: If a world has not been reset yet.
        """

    @abstractmethod
    def state(self) -> SimState:
        """Return the current state without advancing time."""

    @abstractmethod
    def ranges(self, worlds: Tensor | None = None) -> Tensor:
        """Scan worlds from the mount of the lidar.

        Args:
            worlds: [M] int64, worlds to scan; None for all.

        Returns:
            [M, beams] float32 m, noise-free, exactly ``lidar.max_range`` without a hit.

        Raises:
            RuntimeError: If one of the worlds has not been reset yet.
        """

    @abstractmethod
    def walls(self, world: int) -> Tensor:
        """Return the walls of one world, for pictures.

        Args:
            world: Index of the world.

        Returns:
            [W, 5] float64 boxes (cx, cy, hx, hy, yaw), m and rad, world frame.

        Raises:
            RuntimeError: If the world has not been reset yet.
        """

    def scan_motion(self) -> Tensor:
        """Return where the robots were when the current scans were measured.

        Returns:
            [N, 2, 3] float64 (x, y, yaw), m and rad, the robot's frame at the times of the first
            and of the last beam, in its present frame; zeros for a scan without age.
        """
        return self.scan_memory.motion(self._rows["pose"])

    def pending_commands(self) -> tuple[Tensor, Tensor]:
        """Return the commands of the last D steps; D is 0 without delays of commands.

        Returns:
            The commands [N, D, C] float64, latest first, and the substeps [N, D, 2] int64 from now
            until their speed and their other components take effect, 0 or less if they have. The
            latest of those that have taken effect applies now.
        """
        return self.commands.rows["pending"].clone(), self.commands.remaining_substeps()

    def command_delays(self) -> Tensor:
        """Return the delays of speed and other components in these episodes.

        Returns:
            [N, 2] int64 substeps, without jitter.
        """
        return self.commands.rows["delay"].clone()

    def motion_ahead(self) -> tuple[Tensor, Tensor]:
        """Return where the robots are and how they move when a command given now takes effect.

        The commands under way are simulated with the parameters of the episodes, without jitter and
        obstacles. Without delays this is the present.

        Returns:
            The robot's frame [N, 3] float64 (x, y, yaw) at that time, in its present frame, m and
            rad, and its velocity [N, C] float64.
        """
        commands, count = self.commands.upcoming()
        velocity = self._velocity()
        start = velocity.new_zeros(self.num_worlds, 3)
        if commands.shape[1] == 0:
            return start, velocity
        drawn = (self.robot_parameters,) if self.robot_parameters.shape[1] > 0 else ()
        motion = (start, velocity, commands.transpose(0, 1), self.substep_s)
        poses, velocities = self.robot.rollout(*motion, *drawn)
        poses = torch.cat((start[None], poses)).transpose(0, 1)
        velocities = torch.cat((velocity[None], velocities)).transpose(0, 1)
        world = torch.arange(self.num_worlds, device=count.device)
        return poses[world, count], velocities[world, count]

    @abstractmethod
    def _velocity(self) -> Tensor:
        """Return the velocities [N, C] float64 of the robots now."""

    def skip(self, worlds: Tensor) -> None:  # noqa: B027, ignored by default
        """Mark finished worlds; a simulator may skip them until reset.

        Skipped worlds are frozen as after a contact and report the same scan.

        Args:
            worlds: [N] bool.
        """

    def rest(self, worlds: Tensor) -> None:
        """Deprecated name of :meth:`skip`."""
        warn("Simulator.rest", "use skip")
        self.skip(worlds)

    @abstractmethod
    def state_dict(self) -> dict[str, Tensor]:
        """Return the state that :meth:`load_state_dict` needs to continue bit for bit."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Continue from a state of :meth:`state_dict` of a simulator with the same arguments."""

    def clock_state(self) -> dict[str, Tensor]:
        """Return the part of :meth:`state_dict` for delays, robot and pedestrian models."""
        state = {
            f"pedestrians.{name}": rows for name, rows in self.pedestrians.state_dict().items()
        }
        if self.robot_parameters.shape[1] > 0:
            state["robot_parameters"] = self.robot_parameters.clone()
        return state | self.commands.state_dict() | self.scan_memory.state_dict()

    def load_clock_state(self, state: dict[str, Tensor]) -> None:
        """Restore a state of :meth:`clock_state`.

        Raises:
            ValueError: If the delays or the number of the robot's parameters differ.
        """
        drawn = state.get("robot_parameters", self.robot_parameters[:, :0])
        if drawn.shape != self.robot_parameters.shape:
            wanted, got = list(self.robot_parameters.shape), list(drawn.shape)
            raise ValueError(f"state['robot_parameters']: must have shape {wanted}, got {got}")
        self.robot_parameters = drawn.to(self.device, torch.float64, copy=True)
        self.commands.load_state_dict(state)
        self.scan_memory.load_state_dict(state)
        prefix = "pedestrians."
        own = {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
        self.pedestrians.load_state_dict(own)

    def check_reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        """Raise the ``ValueError`` documented in :meth:`reset`."""
        check_reset(worlds, scenarios, self.num_worlds, self.max_pedestrians)

    def check_command(self, command: Tensor) -> None:
        """Raise the ``ValueError`` documented in :meth:`step`.

        Finite values are checked on the CPU only, because the check synchronizes with the host.
        """
        wanted = [self.num_worlds, self.robot.command_size]
        if list(command.shape) != wanted:
            raise ValueError(f"command: must be {wanted}, got {list(command.shape)}")
        if command.device != self.device:
            raise ValueError(f"command: must be on {self.device}, got {command.device}")
        if self.device.type == "cpu" and not bool(torch.isfinite(command).all()):
            raise ValueError("command: must be finite, got NaN or infinity")

    def trajectory(self, pose: Tensor, velocity: Tensor, commands: Tensor) -> tuple[Tensor, Tensor]:
        """Return the motion of all robots in a step without obstacles.

        Args:
            pose: [N, 3] float64 (x, y, yaw), world, m and rad.
            velocity: [N, C] float64, velocity at the start of the step.
            commands: [N, S, C] float64, commands of the substeps, or [N, 1, C] if it is the same in
                all of them.

        Returns:
            [N, S, 5] float64 (x, y, yaw, direction of travel, speed along it) after each substep,
            and the velocities [N, S, C].
        """
        commands = commands.expand(-1, self.substeps, -1).transpose(0, 1)
        drawn = (self.robot_parameters,) if self.robot_parameters.shape[1] > 0 else ()
        poses, velocities = self.robot.rollout(pose, velocity, commands, self.substep_s, *drawn)
        travel = torch.stack(self.robot.travel(poses, velocities), dim=-1)
        track = torch.cat((poses, travel), dim=-1).transpose(0, 1).contiguous()
        return track, velocities.transpose(0, 1)

    def close(self) -> None:
        """Release native resources; a closed simulator cannot be used again."""
        return
