"""Reference simulator: PyBullet computes scans and contacts.

The motion of robots and pedestrians is the same code as in the batched simulator, but rays and
contacts are not computed with navrl's own geometry, so equal episodes on
:class:`navrl.sim.BatchedSimulator` validate both.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Self

import numpy as np
import torch
from torch import Tensor

from navrl.ops.beams import first_beam
from navrl.ops.bodies import STATE_SIZE
from navrl.ops.contact import NONE
from navrl.sim.bullet_client import Client
from navrl.sim.bullet_scene import Scene
from navrl.sim.crowd import PedestrianModel, states_along, step_moves
from navrl.sim.delays import Delays
from navrl.sim.lidar import Lidar
from navrl.sim.robot import RobotModel
from navrl.sim.scenario_rows import ScenarioRows, compact_pedestrians
from navrl.sim.simulator import Simulator
from navrl.sim.state import SimState
from navrl.worlds import ScenarioBatch

# Scatters the order in which stories are built, which keeps PyBullet's tree of bodies balanced;
# otherwise rays in the last of 64 worlds take 6 times as long as in the first.
GOLDEN_RATIO = 0.618034
STOREY_HEIGHT = 100.0  # m between two worlds of one client
MAX_REMOVED_BODIES = 5000  # PyBullet leaks 7 kB per removed body until the simulation is reset


class BulletSimulator(Simulator):
    """Reference simulator on PyBullet: a few hundred scans per second.

    There are no forces: at each substep poses are set and PyBullet is queried for contacts. All
    worlds are stored in one PyBullet client, one below the other, because separate clients would
    take 30 MB per world. Native memory is released by :meth:`close` or at the end of a ``with``
    block.

    Args:
        num_worlds: Number of worlds N.
        robot: Robot model.
        lidar: Lidar model.
        time_step_s: Duration of a step, s.
        substeps: Contact checks per step.
        max_pedestrians: Number of rows K of :attr:`SimState.pedestrians`.
        gui: Whether to show world 0 in PyBullet's window, in real time.
        device: ``cpu``; PyBullet does not support other devices.
        pedestrians: Pedestrian model; None for the routes of the scenario.
        delays: Ages of scans and commands; None for no delays.

    Raises:
        ValueError: If a value is not positive, or ``device`` is not ``cpu``.
        RuntimeError: If ``gui`` is set without a display, or PyBullet has no more clients.

    Reference:
        Paper Sec. IV-A: PyBullet, dt = 0.2 s. Contacts are checked every 0.02 s, so that none is
        missed.
    """

    def __init__(
        self,
        num_worlds: int,
        robot: RobotModel,
        lidar: Lidar,
        time_step_s: float = 0.2,
        substeps: int = 10,
        max_pedestrians: int = 10,
        gui: bool = False,
        device: torch.device | str = "cpu",
        pedestrians: PedestrianModel | None = None,
        delays: Delays | None = None,
    ) -> None:
        self._client: Client | None = None
        if str(device) != "cpu":
            raise ValueError(
                f"device={str(device)!r}: must be cpu for PyBullet; simulator=batched supports cuda"
            )
        super().__init__(
            num_worlds,
            robot,
            lidar,
            time_step_s,
            substeps,
            max_pedestrians,
            pedestrians,
            delays,
        )
        num, real = self.num_worlds, torch.float64
        self._rows = {
            "pose": torch.full((num, 3), torch.nan, dtype=real),  # NaN until a reset
            "velocity": torch.zeros(num, robot.command_size, dtype=real),
            "tick": torch.zeros(num, dtype=torch.int64),  # substeps since the reset
            "contact": torch.zeros(num, dtype=torch.int64),
        }
        if self.pedestrians.is_reactive:  # otherwise the tick determines their positions
            shape = (num, self.max_pedestrians, STATE_SIZE)
            self._rows["boxes"] = torch.full(shape, torch.nan, dtype=real)
        self._skipped = torch.zeros(self.num_worlds, dtype=torch.bool)
        self._scans = torch.empty(self.num_worlds, lidar.num_beams)
        self._is_scanned = torch.zeros(self.num_worlds, dtype=torch.bool)  # saved scan is valid
        self._scenarios = ScenarioRows(self.num_worlds, self.max_pedestrians)
        self._client = Client(gui)
        self._num_removed = 0
        self._scenes = [
            Scene(self._client, robot, lidar, floor=-world * STOREY_HEIGHT)
            for world in range(self.num_worlds)
        ]

    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        self._check_open()
        self.check_reset(worlds, scenarios)
        if len(worlds) == 0:
            return
        self._scenarios.put(worlds, scenarios)
        self._rows["pose"][worlds] = scenarios.start.double()
        for name in ("velocity", "tick", "contact"):
            self._rows[name][worlds] = 0
        self._skipped[worlds] = False
        self._is_scanned[worlds] = False
        if self.pedestrians.is_reactive:
            self._rows["boxes"][worlds] = self._scripted(0, 1)[worlds, 0]
            self.pedestrians.reset(worlds, compact_pedestrians(scenarios, self.max_pedestrians))
        self.robot_parameters[worlds] = self.robot.draw(scenarios.noise_seed)
        self.commands.reset(worlds, scenarios.noise_seed)
        now = {"pose": self._rows["pose"], "boxes": self._boxes()}
        self.scan_memory.reset(worlds, scenarios.noise_seed, now)
        self._build(worlds.tolist())

    def _build(self, worlds: list[int]) -> None:
        """Rebuild these scenes from the rows; rebuild all scenes when PyBullet needs a reset."""
        client = self._check_open()
        self._num_removed += sum(len(self._scenes[world].bodies) for world in worlds)
        if self._num_removed > MAX_REMOVED_BODIES or len(worlds) == self.num_worlds:
            client.resetSimulation()
            self._num_removed = 0
            for scene in self._scenes:
                scene.forget()
            worlds = (~self._rows["pose"].isnan().any(-1)).nonzero().flatten().tolist()
        boxes = self._boxes().tolist()
        with client.paused_drawing():
            for world in sorted(worlds, key=lambda world: world * GOLDEN_RATIO % 1.0):
                self._scenes[world].build(self._scenarios.row(world))
                self._scenes[world].place(self._rows["pose"][world].tolist(), boxes[world])
        if client.is_shown and 0 in worlds:
            self._scenes[0].show()

    def _scripted(self, first: int, count: int) -> Tensor:
        """Return [N, count, K, 7] states on their routes, starting ``first`` substeps from now."""
        tick = self._rows["tick"][:, None] + torch.arange(first, first + count)
        return self._scenarios.pedestrians(tick * self.substep_s)

    def _boxes(self) -> Tensor:
        """Return [N, K, 7] float64, the current states of the pedestrians; NaN rows are absent."""
        return self._rows["boxes"] if self.pedestrians.is_reactive else self._scripted(0, 1)[:, 0]

    def step(self, command: Tensor) -> SimState:
        self._check_ready()
        self.check_command(command)
        commands = self.commands.push(command.detach().double()).tolist()
        moves = (self._rows["contact"] == NONE) & ~self._skipped
        self._is_scanned &= ~moves
        tracks = self._tracks()
        for world in moves.nonzero().flatten().tolist():
            driven = self._drive(world, commands[world], tracks[world, 1:].tolist())
            if self.pedestrians.is_reactive:
                self._rows["boxes"][world] = tracks[world, len(driven)]
            if self.scan_memory.is_used:  # a world is stationary after a contact
                substeps = torch.arange(self.substeps).clamp_max(len(driven) - 1)
                poses = torch.tensor(driven, dtype=torch.float64)[substeps]
                self.scan_memory.write(world, poses, tracks[world, 1 + substeps])
        if self.scan_memory.is_used:
            self.scan_memory.advance(moves)
        return self.state()

    def _tracks(self) -> Tensor:
        """Return [N, S + 1, K, 7], pedestrian states at the start and after each substep."""
        scripted = self._scripted(0, self.substeps + 1)
        if not self.pedestrians.is_reactive:
            return scripted
        boxes = self._rows["boxes"]
        targets = self.pedestrians.targets(self.state(), self.time_step_s)
        moves = step_moves(boxes, targets, self.time_step_s)
        shares = torch.arange(self.substeps + 1, dtype=torch.float64) / self.substeps
        return states_along(moves, boxes, scripted, shares)

    def skip(self, worlds: Tensor) -> None:
        self._skipped = worlds.cpu().clone()

    def _drive(
        self, world: int, commands: list[list[float]], track: list[list[list[float]]]
    ) -> list[Sequence[float]]:
        """Advance one world by a step, or to its first contact.

        ``commands`` are those of the substeps, or a single one; ``track`` has the boxes of the
        pedestrians after each substep.

        Returns:
            The poses after the executed substeps.
        """
        rows, scene = self._rows, self._scenes[world]
        pose: Sequence[float] = rows["pose"][world].tolist()
        velocity: Sequence[float] = rows["velocity"][world].tolist()
        drawn = (self.robot_parameters[world],) if self.robot_parameters.shape[1] > 0 else ()
        poses, contact = [], NONE
        for index, boxes in enumerate(track):
            motion = (pose, velocity, commands[min(index, len(commands) - 1)], self.substep_s)
            pose, velocity = self.robot.advance_one(*motion, *drawn)
            poses.append(pose)
            scene.place(pose, boxes)
            contact = scene.contact(pose, self.robot.travel_one(pose, velocity))
            if world == 0:
                self._check_open().wait_for_real_time(self.substep_s)
            if contact != NONE:
                break
        rows["tick"][world] += len(poses)
        rows["pose"][world] = torch.tensor(pose, dtype=torch.float64)
        rows["velocity"][world] = torch.tensor(velocity, dtype=torch.float64)
        rows["contact"][world] = contact
        return poses

    def state(self) -> SimState:
        rows = self._rows
        return SimState(
            pose=rows["pose"].float(),
            velocity=rows["velocity"].float(),
            contact=rows["contact"].clone(),
            pedestrians=self._boxes()[..., :5].float(),  # copied by the change of dtype
            time_s=(rows["tick"] * self.substep_s).float(),
        )

    def ranges(self, worlds: Tensor | None = None) -> Tensor:
        self._check_ready()
        chosen = torch.arange(self.num_worlds) if worlds is None else worlds
        for world in chosen[~self._is_scanned[chosen]].tolist():
            self._scans[world] = torch.from_numpy(self._scan(world))
        self._is_scanned[chosen] = True
        return self._scans[chosen]  # copied by indexing

    def walls(self, world: int) -> Tensor:
        self._check_ready()
        row = self._scenarios.row(world)
        return row["boxes"][: int(row["num_boxes"])].clone()

    def _scan(self, world: int) -> np.ndarray:
        """Return the scan reported by the lidar of one world, which may be of the past."""
        scene, pose = self._scenes[world], self._rows["pose"][world].tolist()
        if not self.scan_memory.is_used:
            return scene.scan(pose)
        parts, entries = [], self.scan_memory.entries(world)
        for part, (seen, boxes) in enumerate(entries):
            begin, end = (
                first_beam(index, len(entries), self.lidar.num_beams) for index in (part, part + 1)
            )
            scene.place(seen, boxes)
            parts.append(scene.scan(seen, begin, end))
        scene.place(pose, self._boxes()[world].tolist())
        return np.concatenate(parts)

    def render(self, world: int = 0, width: int = 640, height: int = 480) -> np.ndarray:
        """Return a picture [height, width, 3] uint8 of a world from above; needs no display.

        Raises:
            RuntimeError: If a world has not been reset yet.
        """
        self._check_ready()
        return self._scenes[world].render(width, height)

    def _velocity(self) -> Tensor:
        return self._rows["velocity"]

    def state_dict(self) -> dict[str, Tensor]:
        rows = {name: rows.clone() for name, rows in self._rows.items()}
        return rows | self._scenarios.state_dict() | self.clock_state()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        self._check_open()
        for name, rows in self._rows.items():
            if name not in state or state[name].shape != rows.shape:
                got = list(state[name].shape) if name in state else "nothing"
                raise ValueError(f"state[{name!r}]: must have shape {list(rows.shape)}, got {got}")
        self._scenarios.load_state_dict(state)
        self._rows = {name: state[name].to(rows.dtype).clone() for name, rows in self._rows.items()}
        self.load_clock_state(state)
        self._skipped.zero_()
        self._is_scanned.zero_()
        self._build(list(range(self.num_worlds)))

    def _check_open(self) -> Client:
        """Return the client of a simulator that is not closed."""
        if self._client is None:
            raise RuntimeError("the simulator is closed")
        return self._client

    def _check_ready(self) -> None:
        self._check_open()
        if bool(self._rows["pose"].isnan().any()):
            raise RuntimeError("every world must be reset first")

    def close(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # modules may be unloaded at interpreter exit
            self.close()
