"""What a simulator is: robots in scenarios, driven by (v, w), seen through a lidar.

One interface, two simulators: :class:`navrl.sim.BatchedSimulator` for speed and
:class:`navrl.sim.BulletSimulator` as the checked reference. The same scenario and the same commands
give the same episode on both.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from navrl.ops import contact
from navrl.sim.lidar import Lidar
from navrl.sim.robot import DifferentialDrive

if TYPE_CHECKING:
    from navrl.worlds import ScenarioBatch


FARTHEST_M = 10_000.0  # m from the origin, where a float32 pose is still exact to 1 mm


class Contact(IntEnum):
    """What the robot touches, told apart because a robot is not to blame for every contact.

    Decided at the first substep at which the robot's disc reaches a box (distance <= 0). A wall
    wins over a pedestrian touched in the same substep. A pedestrian contact is ``RUN_INTO`` unless
    the robot drives faster than :data:`navrl.ops.contact.MOVING_SPEED` and the pedestrian's nearest
    point lies on the side that it drives towards: then it is ``PEDESTRIAN``. Among several
    pedestrians touched in the same substep, ``PEDESTRIAN`` wins over ``RUN_INTO``.
    """

    NONE = contact.NONE
    STATIC = contact.STATIC  # the robot touched a wall or a piece of furniture
    PEDESTRIAN = contact.PEDESTRIAN  # the robot moved into a pedestrian, walking or standing
    RUN_INTO = contact.RUN_INTO  # a pedestrian moved into the robot


@dataclass
class SimState:
    """The true state of every world after a step: fresh tensors, never views of the simulator.

    Args:
        pose: [N, 3] float32 (x, y, yaw) of the robot, world; yaw in (-pi, pi].
        velocity: [N, 2] float32 (v, w) driven at the end of the last step, m/s and rad/s.
        contact: [N] int64 codes of :class:`Contact`.
        pedestrians: [N, K, 5] float32 (cx, cy, hx, hy, yaw), world; NaN rows where absent.
        time_s: [N] float32, time since the world's reset; stands still after a contact.
    """

    pose: Tensor
    velocity: Tensor
    contact: Tensor
    pedestrians: Tensor
    time_s: Tensor


class Simulator(ABC):
    """N independent worlds, each with one robot, walls and pedestrians on fixed routes.

    A step lasts ``time_step_s`` and is cut into ``substeps``. At each substep the robot and the
    pedestrians are moved to the new time, then contacts are looked for; a world freezes at its
    first contact (pose, pedestrians and clock) and stays frozen, reporting that contact, until it
    is reset. Pedestrians follow their routes in closed form of time, whatever the robot does.

    Attributes:
        num_worlds: N.
        robot: the drive and its limits.
        lidar: the beams; its noise is the environment's business, :meth:`ranges` has none.
        time_step_s: duration of one :meth:`step`, s.
        substeps: contact checks a step.
        max_pedestrians: K, rows of :attr:`SimState.pedestrians` whatever the scenarios hold.
        device: where the outputs live.
    """

    num_worlds: int
    robot: DifferentialDrive
    lidar: Lidar
    time_step_s: float
    substeps: int
    max_pedestrians: int
    device: torch.device

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
            command: [N, 2] (v, w) in m/s and rad/s, clipped to the robot's limits.

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
        if command.shape != (self.num_worlds, 2):
            raise ValueError(f"command must be [{self.num_worlds}, 2], got {list(command.shape)}")
        if command.device != self.device:
            raise ValueError(f"command must be on {self.device}, got {command.device}")
        if self.device.type == "cpu" and not bool(torch.isfinite(command).all()):
            raise ValueError("command must be finite, got NaN or infinity")

    def close(self) -> None:
        """Release what the simulator holds outside Python; a closed simulator is not used again."""
        return


def _impossible(boxes: Tensor, num_boxes: Tensor) -> Tensor:
    """Return [M, W], which leading ``num_boxes`` [M] of ``boxes`` [M, W, 5] no wall can be."""
    is_wall = torch.arange(boxes.shape[1], device=boxes.device) < num_boxes[:, None]
    return is_wall & ~(torch.isfinite(boxes).all(-1) & (boxes[..., 2:4] >= 0.0).all(-1))
