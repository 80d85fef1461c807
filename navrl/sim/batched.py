"""Batched simulator: thousands of worlds stepped and scanned by compiled kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from navrl.checks import check_positive
from navrl.ops.bodies import STATE_SIZE
from navrl.ops.contact import NONE
from navrl.ops.kernels.pedestrians import place_pedestrians_kernel
from navrl.ops.kernels.scans import scan_worlds_kernel
from navrl.ops.kernels.worlds import step_worlds_kernel
from navrl.ops.raycast import beam_directions, beam_grid
from navrl.sim.compiled_drive import drive_parameters, is_compiled
from navrl.sim.crowd import PedestrianModel, step_moves
from navrl.sim.delays import Delays
from navrl.sim.lidar import Lidar
from navrl.sim.obstacle_rows import gaits_of, packed_walk, packed_walls, sorted_walls
from navrl.sim.robot import RobotModel
from navrl.sim.scenario_rows import compact_pedestrians, extended
from navrl.sim.simulator import Simulator
from navrl.sim.state import SimState
from navrl.worlds.scenario import MAX_ROUTE_POINTS

if TYPE_CHECKING:
    from navrl.worlds import ScenarioBatch

_CELLS = ("cell_start", "cell_info")
_GROWING = {"walls": 1, "cell_start": 1, "wall_order": 1, "route": 2, "route_arc": 2, "gaits": 2}
"""Rows with an axis that grows when a scenario needs more."""


class BatchedSimulator(Simulator):
    """Fast simulator whose worlds are rows of a few arrays.

    Geometry is float64, ranges are float32. A world takes about 10 kB, so 4,096 worlds take 40 MB.
    The kernels use as many threads as torch; the result of a world does not depend on their number.
    Results are bit-equal for the same scenarios and commands on one machine.

    Args:
        num_worlds: Number of worlds N.
        robot: Robot model. A :class:`navrl.sim.DifferentialDrive` is compiled; other models, and
            subclasses with an own ``advance``, run their torch code.
        lidar: Lidar model.
        time_step_s: Duration of a step, s.
        substeps: Contact checks per step.
        max_pedestrians: Number of pedestrian rows K in each world.
        pedestrians: Pedestrian model; None for the routes of the scenario.
        delays: Ages of scans and commands; None for no delays.
        max_walls: Initial number of wall rows in each world; grows if a scenario has more.
        device: ``cpu``, or ``cuda`` for the current CUDA device. All state, outputs and commands
            are on this device; scenarios may be on either. Rounding differs between devices: poses
            agree with those on the CPU to about 1e-9 m and ranges to 1e-5 m. On CUDA a step does
            not synchronize with the host: a non-finite command is replaced by zero, and the next
            reset raises the error.

    Raises:
        ValueError: If a value is not positive, or a requirement of ``device`` is missing.

    Reference:
        Paper Sec. IV-A: dt = 0.2 s. Contacts are checked every 0.02 s, so that none is missed.
    """

    def __init__(
        self,
        num_worlds: int,
        robot: RobotModel,
        lidar: Lidar,
        time_step_s: float = 0.2,
        substeps: int = 10,
        max_pedestrians: int = 10,
        max_walls: int = 32,
        device: torch.device | str = "cpu",
        pedestrians: PedestrianModel | None = None,
        delays: Delays | None = None,
    ) -> None:
        super().__init__(
            num_worlds,
            robot,
            lidar,
            time_step_s,
            substeps,
            max_pedestrians,
            pedestrians,
            delays,
            device,
        )
        check_positive(max_walls=max_walls)
        self._timing = (self.substep_s, self.substeps, self.scan_memory.max_jitter)
        self._drive = drive_parameters(robot)
        self._mount = torch.tensor(lidar.mount, dtype=torch.float64, device=self.device)
        self._every_world = torch.arange(self.num_worlds, device=self.device)
        self._beams = (*beam_directions(*lidar.beams, self.device), beam_grid(*lidar.beams))
        self._allocate(max_walls)

    def _allocate(self, max_walls: int) -> None:
        n, k, r = self.num_worlds, self.max_pedestrians, MAX_ROUTE_POINTS
        real = {"dtype": torch.float64, "device": self.device}
        whole = {"dtype": torch.int64, "device": self.device}
        self._rows = {  # documented in navrl.ops.kernels.worlds
            "pose": torch.full((n, 3), torch.nan, **real),  # NaN until the first reset
            "velocity": torch.zeros(n, self.robot.command_size, **real),
            "tick": torch.zeros(n, **whole),
            "contact": torch.zeros(n, **whole),
            "walls": torch.zeros(n, max_walls, 8, **real),
            "num_walls": torch.zeros(n, **whole),
            "cell_start": torch.zeros(n, 2, **whole),
            "wall_order": torch.zeros(n, max_walls, **whole),
            "cell_info": torch.zeros(n, 5, **real),
            "route": torch.zeros(n, k, r, 2, **real),
            "route_arc": torch.zeros(n, k, r, **real),
            "gaits": torch.zeros(n, k, 0, 3, **real),
            "walk": torch.full((n, k, 7), torch.nan, **real),
            "boxes": torch.full((n, k, STATE_SIZE), torch.nan, **real),
        }
        rows = k if self.pedestrians.is_reactive else 0
        self._moves = torch.full((n, rows, 8), torch.nan, **real)  # of the current step
        # Placeholders for kernel arguments that other robot models or delays use:
        self._track = torch.zeros(n, 1, 5, **real)
        self._no_age = torch.zeros(n, **whole)
        self._is_ready = False
        self._all_finite = torch.ones((), dtype=torch.bool, device=self.device)
        self._make_scratch()

    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        worlds, scenarios = worlds.to(self.device), scenarios.to(self.device)
        self.check_reset(worlds, scenarios)
        self._check_last_commands()
        if len(worlds) == 0:
            return
        rows = self._rows
        rows["pose"][worlds] = scenarios.start.double()
        rows["num_walls"][worlds] = scenarios.num_boxes
        walls = packed_walls(scenarios, self.lidar.height, self.robot.height)
        for name, value in sorted_walls(scenarios, walls).items():
            self._put(name, worlds, value)
        for name in ("velocity", "tick", "contact"):
            rows[name][worlds] = 0
        self._reset_pedestrians(worlds, scenarios)
        self.robot_parameters[worlds] = self.robot.draw(scenarios.noise_seed)
        self.commands.reset(worlds, scenarios.noise_seed)
        self.scan_memory.reset(worlds, scenarios.noise_seed, self._scene)
        if self.pedestrians.is_reactive:
            self.pedestrians.reset(worlds, compact_pedestrians(scenarios, self.max_pedestrians))
        self._is_ready = self._is_ready or not bool(rows["pose"].isnan().any())

    @property
    def _scene(self) -> dict[str, Tensor]:
        """Current poses and boxes, the moving part of a scan."""
        return {name: self._rows[name] for name in ("pose", "boxes")}

    def _put(self, name: str, worlds: Tensor, value: Tensor) -> None:
        """Write rows that may have another number of columns; there are more if necessary."""
        rows = self._rows[name]
        if value.shape[1] > rows.shape[1]:
            pad = [0, 0] * (rows.ndim - 2) + [0, value.shape[1] - rows.shape[1]]
            rows = self._rows[name] = torch.nn.functional.pad(rows, pad)
            self._make_scratch()
        rows[worlds, : value.shape[1]] = value

    def _make_scratch(self) -> None:
        """Allocate the scratch memory of the kernel for all rows of walls and pedestrians."""
        num_boxes = self._rows["walls"].shape[1] + self.max_pedestrians
        self._near = self._rows["tick"].new_empty(self.num_worlds, num_boxes)

    def _reset_pedestrians(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        rows = self._rows
        # present pedestrians move to the front, because a scenario may have more than K rows
        scenarios = compact_pedestrians(scenarios, self.max_pedestrians)
        rows["walk"][worlds] = packed_walk(scenarios)
        points = scenarios.route.shape[2]
        for name, value in (
            ("route", scenarios.route),
            ("route_arc", scenarios.route_arc),
            ("gaits", gaits_of(scenarios)),
        ):
            missing = points - rows[name].shape[2]
            if missing > 0 and value.shape[2] > 0:  # rows of other worlds repeat their last point
                rows[name] = extended(rows[name], missing)
            rows[name][worlds] = extended(value, rows[name].shape[2] - value.shape[2])
        self._moves[worlds] = torch.nan
        place_pedestrians_kernel(
            worlds,
            *(rows[name] for name in ("boxes", "route", "route_arc", "walk", "gaits")),
            self._moves,
            rows["tick"],
            self.substep_s,
        )

    def _check_last_commands(self) -> None:
        """Raise the error that :meth:`step` defers on CUDA to avoid synchronization."""
        if self.device.type == "cpu" or bool(self._all_finite):
            return
        self._all_finite.fill_(True)
        raise ValueError("command: must be finite, got NaN or infinity since the last reset")

    def _finite(self, command: Tensor) -> Tensor:
        """Replace non-finite commands on CUDA by zero and record that there were any."""
        if self.device.type == "cpu":
            return command
        self._all_finite.logical_and_(torch.isfinite(command).all())
        return torch.nan_to_num(command, nan=0.0, posinf=0.0, neginf=0.0)

    def step(self, command: Tensor) -> SimState:
        self.check_command(command)
        if not self._is_ready:
            raise RuntimeError("every world must be reset before the first step")
        rows = self._rows
        commands = self.commands.push(self._finite(command).double().contiguous())
        if self.pedestrians.is_reactive:
            targets = self.pedestrians.targets(self.state(), self.time_step_s)
            self._moves = step_moves(rows["boxes"], targets, self.time_step_s)
        velocities = None
        if not is_compiled(self.robot):
            self._track, velocities = self.trajectory(rows["pose"], rows["velocity"], commands)
        before = rows["tick"].clone() if velocities is not None else None
        past = self.scan_memory.rows
        moved = rows["contact"] == NONE if self.scan_memory.is_used else None
        step_worlds_kernel(
            *(rows[name] for name in ("pose", "velocity", "tick", "contact")),
            commands,
            self._track,
            self._drive,
            self._timing,
            *(rows[name] for name in ("walls", "num_walls", *_CELLS)),
            *(rows[name] for name in ("route", "route_arc", "walk", "gaits")),
            self._moves,
            rows["boxes"],
            self._near,
            *(past[name] for name in ("pose", "boxes", "present", "delay", "sweep")),
        )
        if moved is not None:
            self.scan_memory.advance(moved)
        if velocities is not None and before is not None:
            driven = rows["tick"] - before
            last = velocities[self._every_world, (driven - 1).clamp_min(0)]
            rows["velocity"] = torch.where(driven[:, None] > 0, last, rows["velocity"])
        return self.state()

    def state(self) -> SimState:
        rows = self._rows
        return SimState(
            pose=rows["pose"].float(),
            velocity=rows["velocity"].float(),
            contact=rows["contact"].clone(),
            pedestrians=rows["boxes"][..., :5].float(),
            time_s=(rows["tick"] * self.substep_s).float(),
        )

    def ranges(self, worlds: Tensor | None = None, has_pedestrians: bool = True) -> Tensor:
        """Scan worlds; see :meth:`Simulator.ranges`.

        Args:
            worlds: [M] int64, worlds to scan; None for all.
            has_pedestrians: False scans without pedestrians, which shows the beams that hit them.
        """
        worlds = self._every_world if worlds is None else worlds.to(self.device)
        if not self._is_ready and bool(self._rows["pose"][worlds].isnan().any()):
            raise RuntimeError("every world must be reset before the first scan")
        out = torch.empty(len(worlds), self.lidar.num_beams, device=self.device)
        seen = {name: rows[:, None] for name, rows in self._scene.items()}
        newest = sweep = self._no_age
        if self.scan_memory.is_used:
            memory = self.scan_memory
            seen, newest, sweep = memory.rows, memory.newest, memory.sweep
        boxes = seen["boxes"] if has_pedestrians else torch.full_like(seen["boxes"], torch.nan)
        scan_worlds_kernel(
            out,
            worlds,
            seen["pose"],
            self._mount,
            *(self._rows[name] for name in ("walls", "num_walls", *_CELLS)),
            boxes,
            self._rows["walk"],
            newest,
            sweep,
            *self._beams,
            self.lidar.max_range,
        )
        return out

    def walls(self, world: int) -> Tensor:
        rows = self._rows
        if bool(rows["pose"][world].isnan().any()):
            raise RuntimeError(f"world {world} must be reset first")
        walls = rows["walls"][world, : int(rows["num_walls"][world])]
        yaw = torch.atan2(walls[:, 5], walls[:, 4])  # 0 for a disc
        boxes = torch.cat((walls[:, :4], yaw[:, None]), dim=-1)
        return boxes[rows["wall_order"][world, : len(walls)].argsort()]

    def _velocity(self) -> Tensor:
        return self._rows["velocity"]

    def state_dict(self) -> dict[str, Tensor]:
        rows = {name: rows.clone() for name, rows in self._rows.items()}
        return rows | self.clock_state()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        needed = self._rows.keys() | self.clock_state().keys()
        if state.keys() != needed:
            raise ValueError(f"state: must have the keys {sorted(needed)}, got {sorted(state)}")
        for name, rows in self._rows.items():
            wanted, got = list(rows.shape), list(state[name].shape)
            axis = _GROWING.get(name)
            if axis is not None:
                wanted[axis] = got[axis] if len(got) == len(wanted) else -1
            if wanted != got:
                raise ValueError(f"state[{name!r}]: must have shape {wanted}, got {got}")
        self._rows = {
            name: state[name].to(self.device, rows.dtype, copy=True)
            for name, rows in self._rows.items()
        }
        self.load_clock_state(state)
        self._is_ready = not bool(self._rows["pose"].isnan().any())
        self._make_scratch()
