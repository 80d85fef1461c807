"""The reference simulator: PyBullet says what the lidar sees and what the robot touches.

The drive and the pedestrians' routes are the same code as everywhere, but no ray and no contact is
computed with navrl's own geometry, so that equal episodes on
:class:`navrl.sim.BatchedSimulator` are evidence for both.
"""

from __future__ import annotations

import contextlib
import functools
import time
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from navrl.ops.contact import NONE
from navrl.sim.bullet_scene import Scene
from navrl.sim.display import require_display
from navrl.sim.lidar import Lidar
from navrl.sim.robot import DifferentialDrive
from navrl.sim.scenario_rows import ScenarioRows
from navrl.sim.simulator import SimState, Simulator
from navrl.worlds import ScenarioBatch

try:
    import pybullet
except ImportError as error:
    raise ImportError(
        "BulletSimulator needs PyBullet, which is not installed: pip install pybullet"
    ) from error

GOLDEN_RATIO = 0.618034  # scatters the order in which storeys are built: PyBullet's tree of bodies
# stays balanced, and rays in the last of 64 worlds cost as much as in the first (else 6 times more)
STOREY_HEIGHT = 100.0  # m between two worlds of one client
MAX_REMOVED_BODIES = 5000  # PyBullet keeps 7 kB of each body removed until it starts afresh


class BulletSimulator(Simulator):
    """The checked simulator: a few hundred scans a second.

    Nothing is driven by forces: at each substep poses are set and PyBullet is asked for contacts.
    All worlds live in one PyBullet client, one below the other: a client of its own for each would
    cost 30 MB a world. Native memory is held until :meth:`close`; leaving a ``with`` block closes
    the simulator too.

    Args:
        num_worlds: N.
        robot: its drive and limits.
        lidar: its beams.
        time_step_s: duration of a step, s.
        substeps: contact checks a step.
        max_pedestrians: K, rows of :attr:`SimState.pedestrians`.
        gui: whether to show world 0 in PyBullet's window, in real time.
        device: ``cpu``, PyBullet has no other.

    Raises:
        ValueError: a value is not positive, or ``device`` is not ``cpu``.
        RuntimeError: ``gui`` without a display, or PyBullet gives no more clients.

    Reference:
        Paper Sec. IV-A: PyBullet, dt = 0.2 s. Contacts are looked for every 0.02 s here, so none
        is passed over.
    """

    def __init__(
        self,
        num_worlds: int,
        robot: DifferentialDrive,
        lidar: Lidar,
        time_step_s: float = 0.2,
        substeps: int = 10,
        max_pedestrians: int = 10,
        gui: bool = False,
        device: torch.device | str = "cpu",
    ) -> None:
        self._client: Client | None = None
        if str(device) != "cpu":
            raise ValueError(
                f"device={str(device)!r}: PyBullet runs on the cpu; simulator=batched runs on both"
            )
        positive = {
            "num_worlds": num_worlds,
            "time_step_s": time_step_s,
            "substeps": substeps,
            "max_pedestrians": max_pedestrians,
        }
        for name, value in positive.items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}")
        self.num_worlds, self.robot, self.lidar = int(num_worlds), robot, lidar
        self.time_step_s, self.substeps = float(time_step_s), int(substeps)
        self.max_pedestrians = int(max_pedestrians)
        self.device = torch.device("cpu")
        self._substep_s = self.time_step_s / self.substeps
        real, whole = {"dtype": torch.float64}, {"dtype": torch.int64}
        self._rows = {
            "pose": torch.full((self.num_worlds, 3), torch.nan, **real),  # NaN until a reset
            "velocity": torch.zeros(self.num_worlds, 2, **real),
            "tick": torch.zeros(self.num_worlds, **whole),  # substeps since the reset
            "contact": torch.zeros(self.num_worlds, **whole),
        }
        self._rests = torch.zeros(self.num_worlds, dtype=torch.bool)
        self._scans = torch.empty(self.num_worlds, lidar.num_beams)
        self._is_scanned = torch.zeros(self.num_worlds, dtype=torch.bool)  # and is still there
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
        self._rests[worlds] = False
        self._is_scanned[worlds] = False
        self._build(worlds.tolist())

    def _build(self, worlds: list[int]) -> None:
        """Make these scenes anew, everything where the rows say; now and then all scenes."""
        self._num_removed += sum(len(self._scenes[world].bodies) for world in worlds)
        if self._num_removed > MAX_REMOVED_BODIES or len(worlds) == self.num_worlds:
            self._client.resetSimulation()
            self._num_removed = 0
            for scene in self._scenes:
                scene.forget()
            worlds = (~self._rows["pose"].isnan().any(-1)).nonzero().flatten().tolist()
        boxes = self._pedestrians(0, 1)[:, 0].tolist()
        with self._client.paused_drawing():
            for world in sorted(worlds, key=lambda world: world * GOLDEN_RATIO % 1.0):
                self._scenes[world].build(self._scenarios.row(world))
                self._scenes[world].place(self._rows["pose"][world].tolist(), boxes[world])
        if self._client.is_shown and 0 in worlds:
            self._scenes[0].show()

    def _pedestrians(self, first: int, count: int) -> Tensor:
        """Return [N, count, K, 5] boxes, from ``first`` substeps after each world's now."""
        tick = self._rows["tick"][:, None] + torch.arange(first, first + count)
        return self._scenarios.pedestrians(tick * self._substep_s)

    def step(self, command: Tensor) -> SimState:
        self._check_ready()
        self.check_command(command)
        commands = command.detach().double().tolist()
        tracks = self._pedestrians(1, self.substeps).tolist()
        moves = (self._rows["contact"] == NONE) & ~self._rests
        self._is_scanned[moves] = False
        for world in moves.nonzero().flatten().tolist():
            self._drive(world, commands[world], tracks[world])
        return self.state()

    def rest(self, worlds: Tensor) -> None:
        self._rests = worlds.cpu().clone()

    def _drive(self, world: int, command: list[float], track: list[list[list[float]]]) -> None:
        """Advance one world by a step, or to its first contact."""
        rows, scene = self._rows, self._scenes[world]
        pose, velocity = rows["pose"][world].tolist(), rows["velocity"][world].tolist()
        for boxes in track:
            pose, velocity = self.robot.advance_one(pose, velocity, command, self._substep_s)
            rows["tick"][world] += 1
            scene.place(pose, boxes)
            contact = scene.contact(pose, velocity[0])
            if world == 0:
                self._client.keep_pace(self._substep_s)
            if contact != NONE:
                break
        rows["pose"][world] = torch.tensor(pose, dtype=torch.float64)
        rows["velocity"][world] = torch.tensor(velocity, dtype=torch.float64)
        rows["contact"][world] = contact

    def state(self) -> SimState:
        rows = self._rows
        return SimState(
            pose=rows["pose"].float(),
            velocity=rows["velocity"].float(),
            contact=rows["contact"].clone(),
            pedestrians=self._pedestrians(0, 1)[:, 0].float(),
            time_s=(rows["tick"] * self._substep_s).float(),
        )

    def ranges(self, worlds: Tensor | None = None) -> Tensor:
        self._check_ready()
        chosen = torch.arange(self.num_worlds) if worlds is None else worlds
        poses = self._rows["pose"].tolist()
        for world in chosen[~self._is_scanned[chosen]].tolist():
            self._scans[world] = torch.from_numpy(self._scenes[world].scan(poses[world]))
        self._is_scanned[chosen] = True
        return self._scans[chosen]  # a copy

    def walls(self, world: int) -> Tensor:
        self._check_ready()
        row = self._scenarios.row(world)
        return row["boxes"][: int(row["num_boxes"])].clone()

    def render(self, world: int = 0, width: int = 640, height: int = 480) -> np.ndarray:
        """Return a picture [height, width, 3] uint8 of a world from above; needs no display.

        Raises:
            RuntimeError: a world has not been reset yet.
        """
        self._check_ready()
        return self._scenes[world].render(width, height)

    def state_dict(self) -> dict[str, Tensor]:
        rows = {name: rows.clone() for name, rows in self._rows.items()}
        return rows | self._scenarios.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        self._check_open()
        for name, rows in self._rows.items():
            if name not in state or state[name].shape != rows.shape:
                got = list(state[name].shape) if name in state else "nothing"
                raise ValueError(f"state[{name!r}] must be {list(rows.shape)}, got {got}")
        self._scenarios.load_state_dict(state)
        self._rows = {name: state[name].to(rows.dtype).clone() for name, rows in self._rows.items()}
        self._rests.zero_()
        self._is_scanned.zero_()
        self._build(list(range(self.num_worlds)))

    def _check_open(self) -> None:
        if self._client is None:
            raise RuntimeError("the simulator is closed")

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
        with contextlib.suppress(Exception):  # when the interpreter ends, modules may be gone
            self.close()


class Client:
    """A connection to PyBullet: ``client.f(...)`` is ``pybullet.f(..., physicsClientId=...)``.

    Args:
        is_shown: whether to open a window.

    Raises:
        RuntimeError: no display, or no more clients.
    """

    def __init__(self, is_shown: bool) -> None:
        if is_shown:
            require_display()
        self.is_shown, self._due = is_shown, 0.0
        try:
            self._id = pybullet.connect(pybullet.GUI if is_shown else pybullet.DIRECT)
        except pybullet.error as error:
            raise RuntimeError(f"PyBullet gives no client: {error}") from error
        if self._id < 0:
            raise RuntimeError("PyBullet gives no client: too many are open in this process")
        if is_shown:
            self.configureDebugVisualizer(pybullet.COV_ENABLE_GUI, 0)

    def __getattr__(self, name: str) -> Any:
        value = getattr(pybullet, name)
        if callable(value):
            value = functools.partial(value, physicsClientId=self._id)
        setattr(self, name, value)
        return value

    @contextlib.contextmanager
    def paused_drawing(self):
        """Keep the window still while bodies are made."""
        if self.is_shown:
            self.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 0)
        yield
        if self.is_shown:
            self.configureDebugVisualizer(pybullet.COV_ENABLE_RENDERING, 1)

    def keep_pace(self, duration: float) -> None:
        """Wait until ``duration`` s after the last call, if somebody watches."""
        if self.is_shown:
            now = time.monotonic()
            self._due = max(self._due + duration, now - duration)
            time.sleep(max(self._due - now, 0.0))

    def close(self) -> None:
        """Disconnect, which frees all of the client's memory."""
        if pybullet.isConnected(self._id):
            pybullet.disconnect(self._id)
