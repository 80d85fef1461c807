"""What a simulator is: robots in scenarios, driven by (v, w), seen through a lidar.

One interface, two simulators: :class:`navrl.sim.BatchedSimulator` for speed and
:class:`navrl.sim.BulletSimulator` as the checked reference. The same scenario and the same commands
give the same episode on both.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from navrl.ops.backend import find_device
from navrl.sim.crowd import PedestrianModel, ScriptedRoutes
from navrl.sim.delays import CommandQueue, Delays, ScanMemory
from navrl.sim.lidar import Lidar
from navrl.sim.robot import RobotModel
from navrl.sim.state import SimState

if TYPE_CHECKING:
    from navrl.worlds import ScenarioBatch


FARTHEST_M = 10_000.0  # m from the origin, where a float32 pose is still exact to 1 mm


class Simulator(ABC):
    """N independent worlds, each with one robot, walls and pedestrians on fixed routes.

    A step lasts ``time_step_s`` and is cut into ``substeps``. At each substep the robot and the
    pedestrians are moved to the new time, then contacts are looked for; a world freezes at its
    first contact (pose, pedestrians and clock) and stays frozen, reporting that contact, until it
    is reset. Without a reactive model, pedestrians follow their routes in closed form of time.

    Args:
        num_worlds: N.
        robot: the base: hull, command limits, motion.
        lidar: the beams; its noise is the environment's business, :meth:`ranges` has none.
        time_step_s: duration of one :meth:`step`, s.
        substeps: contact checks a step.
        max_pedestrians: K, rows of :attr:`SimState.pedestrians` whatever the scenarios hold.
        pedestrians: where pedestrians walk; their scenario's routes if None.
        delays: ages of scans and commands, whole numbers of substeps; none if None.
        device: where the outputs are stored.

    Raises:
        ValueError: a value is not positive, a delay is no multiple of the substep, or something is
            missing for ``device``.
    """

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
        positive = {
            "num_worlds": num_worlds,
            "time_step_s": time_step_s,
            "substeps": substeps,
            "max_pedestrians": max_pedestrians,
        }
        for name, value in positive.items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}")
        self.num_worlds, self.max_pedestrians = int(num_worlds), int(max_pedestrians)
        self.time_step_s, self.substeps = float(time_step_s), int(substeps)
        self.substep_s = self.time_step_s / self.substeps
        self.robot, self.lidar = robot, lidar
        self.pedestrians = ScriptedRoutes() if pedestrians is None else pedestrians
        self.device = find_device(device)
        delays = Delays() if delays is None else delays
        clock = (delays, self.substeps, self.substep_s)
        self.commands = CommandQueue(self.num_worlds, robot.command_size, *clock, self.device)
        self.scan_memory = ScanMemory(*clock)

    @abstractmethod
    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        """Put scenario ``i`` into world ``worlds[i]``: robot at its start, at rest, time zero.

        Other worlds are untouched, bit for bit.

        Args:
            worlds: [M] int64, distinct world indices.
            scenarios: M scenarios with at most ``max_pedestrians`` pedestrians each.

        Raises:
            ValueError: lengths differ, an index is out of range or repeated, a scenario has more
                pedestrians than ``max_pedestrians``, or a wall of it is impossible.
        """

    @abstractmethod
    def step(self, command: Tensor) -> SimState:
        """Drive every robot for ``time_step_s``.

        Args:
            command: [N, C] in the robot's components, e.g. (v, w) in m/s and rad/s; clipped to
                its limits.

        Returns:
            The state after the step.

        Raises:
            ValueError: wrong shape, or a value that is not finite.
            RuntimeError: a world has not been reset yet.
        """

    @abstractmethod
    def state(self) -> SimState:
        """Return the current state without advancing time."""

    @abstractmethod
    def ranges(self, worlds: Tensor | None = None) -> Tensor:
        """Scan worlds from their lidar's mount.

        Args:
            worlds: [M] int64, the worlds to scan; all of them if None.

        Returns:
            [M, beams] float32 m, noise-free, exactly ``lidar.max_range`` where nothing is hit.

        Raises:
            RuntimeError: one of the worlds has not been reset yet.
        """

    @abstractmethod
    def walls(self, world: int) -> Tensor:
        """Return the walls of one world, for pictures.

        Args:
            world: Index of the world.

        Returns:
            [W, 5] float64 boxes (cx, cy, hx, hy, yaw), m and rad, world frame.

        Raises:
            RuntimeError: the world has not been reset yet.
        """

    def rest(self, worlds: Tensor) -> None:  # noqa: B027, to ignore it is the rule
        """Say which worlds nobody needs any more until they are reset.

        A simulator that spares itself much by it leaves them as they are, frozen as after a contact
        and with the same scan; others ignore it.

        Args:
            worlds: [N] bool.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Tensor]:
        """Everything that :meth:`load_state_dict` needs to continue bit for bit."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Continue from what :meth:`state_dict` returned, of a simulator built alike."""

    def clock_state(self) -> dict[str, Tensor]:
        """Return the part of :meth:`state_dict` that delays and pedestrian model need."""
        state = {
            f"pedestrians.{name}": rows for name, rows in self.pedestrians.state_dict().items()
        }
        if self.commands.pending.shape[1] > 0:
            state["pending_commands"] = self.commands.pending.clone()
        return state | self.scan_memory.state_dict()

    def load_clock_state(self, state: dict[str, Tensor]) -> None:
        """Restore what :meth:`clock_state` returned.

        Raises:
            ValueError: the delays differ.
        """
        pending = state.get("pending_commands", self.commands.pending)
        if pending.shape != self.commands.pending.shape:
            wanted, got = list(self.commands.pending.shape), list(pending.shape)
            raise ValueError(f"state['pending_commands'] must be {wanted}, got {got}")
        self.commands.pending = pending.to(self.device, torch.float64, copy=True)
        self.scan_memory.load_state_dict(state, self.device)
        prefix = "pedestrians."
        own = {k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)}
        self.pedestrians.load_state_dict(own)

    def check_reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        """Raise what :meth:`reset` promises to raise."""
        if worlds.ndim != 1 or worlds.dtype != torch.int64:
            raise ValueError(f"worlds must be [M] int64, got {list(worlds.shape)} {worlds.dtype}")
        if len(worlds) != len(scenarios):
            raise ValueError(f"{len(worlds)} worlds to reset but {len(scenarios)} scenarios")
        if len(worlds) == 0:
            return
        inside = worlds.clamp(0, self.num_worlds - 1)
        times = worlds.new_zeros(self.num_worlds).index_add_(0, inside, torch.ones_like(worlds))
        most = scenarios.ped_present.sum(-1).amax()
        bad_walls = _impossible(scenarios.boxes, scenarios.num_boxes)
        verdicts = [
            (inside != worlds).any(),
            times.amax() > 1,
            most > self.max_pedestrians,
            ~(scenarios.start.abs() <= FARTHEST_M).all(),  # NaN too
            bad_walls.any(),
        ]
        # All verdicts at once, since a device has to be waited for.
        outside, repeated, crowded, nowhere, impossible = torch.stack(verdicts).tolist()
        if outside:
            raise ValueError(f"worlds must be within 0..{self.num_worlds - 1}")
        if repeated:
            raise ValueError("worlds must be distinct")
        if crowded:
            raise ValueError(
                f"a scenario has {int(most)} pedestrians, max_pedestrians is {self.max_pedestrians}"
            )
        if nowhere:
            raise ValueError(
                f"scenarios.start must be finite and within {FARTHEST_M:.0f} m of the origin: "
                "poses are float32; shift the scenario"
            )
        if impossible:
            row, wall = bad_walls.nonzero()[0].tolist()
            raise ValueError(
                f"wall {wall} of scenario {row} must be finite with half sizes >= 0, "
                f"got {scenarios.boxes[row, wall].tolist()}"
            )

    def check_command(self, command: Tensor) -> None:
        """Raise the ``ValueError`` that :meth:`step` promises.

        Whether numbers are finite is looked at on the CPU only: a device would have to be waited
        for.
        """
        wanted = [self.num_worlds, self.robot.command_size]
        if list(command.shape) != wanted:
            raise ValueError(f"command must be {wanted}, got {list(command.shape)}")
        if command.device != self.device:
            raise ValueError(f"command must be on {self.device}, got {command.device}")
        if self.device.type == "cpu" and not bool(torch.isfinite(command).all()):
            raise ValueError("command must be finite, got NaN or infinity")

    def trajectory(
        self, pose: Tensor, velocity: Tensor, older: Tensor, newer: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Drive all robots for a step without obstacles, by :meth:`RobotModel.advance`.

        Args:
            pose: [N, 3] float64 (x, y, yaw), world.
            velocity: [N, C] float64.
            older: [N, C] float64, the command before the delays have passed.
            newer: [N, C] float64, the command after.

        Returns:
            [N, S, 5] float64 (x, y, yaw, direction of travel, speed along it) after each substep,
            and the velocities [N, S, C].
        """
        first = torch.tensor(self.commands.first_substeps, device=pose.device)
        first = first[[0] + [1] * (self.robot.command_size - 1)]  # others go with the turn rate
        points, velocities = [], []
        for index in range(self.substeps):
            command = torch.where(index >= first, newer, older)
            pose, velocity = self.robot.advance(pose, velocity, command, self.substep_s)
            points.append(torch.cat((pose, torch.stack(self.robot.travel(pose, velocity), -1)), -1))
            velocities.append(velocity)
        return torch.stack(points, dim=1), torch.stack(velocities, dim=1)

    def close(self) -> None:
        """Release what the simulator holds outside Python; a closed simulator is not used again."""
        return


def _impossible(boxes: Tensor, num_boxes: Tensor) -> Tensor:
    """Return [M, W], which leading ``num_boxes`` [M] of ``boxes`` [M, W, 5] no wall can be."""
    is_wall = torch.arange(boxes.shape[1], device=boxes.device) < num_boxes[:, None]
    return is_wall & ~(torch.isfinite(boxes).all(-1) & (boxes[..., 2:4] >= 0.0).all(-1))
