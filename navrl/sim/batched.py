"""Thousands of worlds in one process, stepped and scanned by compiled kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from navrl.ops.backend import find_device
from navrl.ops.kernels.worlds import (
    place_pedestrians_kernel,
    scan_worlds_kernel,
    step_worlds_kernel,
)
from navrl.ops.raycast import beam_directions
from navrl.sim.lidar import Lidar
from navrl.sim.robot import DifferentialDrive
from navrl.sim.simulator import SimState, Simulator
from navrl.worlds.scenario import MAX_ROUTE_POINTS

if TYPE_CHECKING:
    from navrl.worlds import ScenarioBatch


class BatchedSimulator(Simulator):
    """The fast simulator: all of the worlds are rows of a few arrays.

    Geometry is float64, ranges are float32. A world costs about 10 kB, so 4,096 of them take 40 MB.
    The kernels run on as many threads as torch is set to use, and each world's result is the same
    for any number of them. Bit-equal for the same scenarios and commands on one machine.

    Args:
        num_worlds: N.
        robot: its drive and limits.
        lidar: its beams.
        time_step_s: duration of a step, s.
        substeps: contact checks a step.
        max_pedestrians: K, rows kept for pedestrians in each world.
        max_walls: rows kept for walls in each world; grows when a scenario has more.
        device: ``cpu``, or ``cuda`` for the current CUDA device, where then all state and outputs
            are, and where commands come from. Scenarios may be on either. A device rounds in its
            own way, so poses agree with the CPU's to about 1e-9 m and ranges to 1e-5 m. A step
            does not wait for the device: there a command that is not finite drives as zero, and
            the next reset raises the error.

    Raises:
        ValueError: a value is not positive, or something is missing for ``device``.

    Reference:
        Paper Sec. IV-A: dt = 0.2 s. Contacts are looked for every 0.02 s, so none is passed over.
    """

    def __init__(
        self,
        num_worlds: int,
        robot: DifferentialDrive,
        lidar: Lidar,
        time_step_s: float = 0.2,
        substeps: int = 10,
        max_pedestrians: int = 10,
        max_walls: int = 32,
        device: torch.device | str = "cpu",
    ) -> None:
        positive = {
            "num_worlds": num_worlds,
            "time_step_s": time_step_s,
            "substeps": substeps,
            "max_pedestrians": max_pedestrians,
            "max_walls": max_walls,
        }
        for name, value in positive.items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}")
        self.num_worlds = int(num_worlds)
        self.robot, self.lidar = robot, lidar
        self.time_step_s, self.substeps = float(time_step_s), int(substeps)
        self.max_pedestrians = int(max_pedestrians)
        self.device = find_device(device)
        self._timing = (self.time_step_s / self.substeps, self.substeps)
        self._drive = (
            robot.radius,
            robot.wheel_separation,
            robot.acceleration_limit,
            robot.min_speed,
            robot.max_speed,
            robot.max_turn_rate,
        )
        self._mount = torch.tensor(lidar.mount, dtype=torch.float64, device=self.device)
        self._every_world = torch.arange(self.num_worlds, device=self.device)
        self._beams = beam_directions(lidar.num_beams, self.device)
        self._allocate(max_walls)

    def _allocate(self, max_walls: int) -> None:
        n, k, r = self.num_worlds, self.max_pedestrians, MAX_ROUTE_POINTS
        real = {"dtype": torch.float64, "device": self.device}
        whole = {"dtype": torch.int64, "device": self.device}
        self._rows = {  # documented in navrl.ops.kernels.worlds
            "pose": torch.full((n, 3), torch.nan, **real),  # NaN until the first reset
            "velocity": torch.zeros(n, 2, **real),
            "tick": torch.zeros(n, **whole),
            "contact": torch.zeros(n, **whole),
            "walls": torch.zeros(n, max_walls, 6, **real),
            "num_walls": torch.zeros(n, **whole),
            "route": torch.zeros(n, k, r, 2, **real),
            "route_arc": torch.zeros(n, k, r, **real),
            "walk": torch.full((n, k, 4), torch.nan, **real),
            "boxes": torch.full((n, k, 5), torch.nan, **real),
        }
        self._is_ready = False
        self._all_finite = torch.ones((), dtype=torch.bool, device=self.device)
        self._make_scratch()

    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        worlds, scenarios = worlds.to(self.device), scenarios.to(self.device)
        self.check_reset(worlds, scenarios)
        self._check_last_commands()
        if len(worlds) == 0:
            return
        rows, count = self._rows, scenarios.boxes.shape[1]
        self._make_room(count)
        rows["pose"][worlds] = scenarios.start.double()
        rows["walls"][worlds, :count] = _packed_walls(scenarios)
        rows["num_walls"][worlds] = scenarios.num_boxes
        for name in ("velocity", "tick", "contact"):
            rows[name][worlds] = 0
        self._reset_pedestrians(worlds, scenarios)
        self._is_ready = self._is_ready or not bool(rows["pose"].isnan().any())

    def _make_room(self, num_walls: int) -> None:
        walls = self._rows["walls"]
        if num_walls > walls.shape[1]:
            missing = num_walls - walls.shape[1]
            self._rows["walls"] = torch.nn.functional.pad(walls, (0, 0, 0, missing))
            self._make_scratch()

    def _make_scratch(self) -> None:
        """Make the kernel's scratch as wide as the rows of walls and pedestrians."""
        num_boxes = self._rows["walls"].shape[1] + self.max_pedestrians
        self._near = self._rows["tick"].new_empty(self.num_worlds, num_boxes)

    def _reset_pedestrians(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        rows = self._rows
        # present pedestrians move to the front, in their order, if there are more rows than K
        order = torch.argsort(~scenarios.ped_present, dim=1, stable=True)
        order = order[:, : self.max_pedestrians]
        row, count = torch.arange(len(worlds), device=self.device)[:, None], order.shape[1]
        walk = torch.cat(
            (scenarios.ped_speed[..., None], scenarios.ped_offset[..., None], scenarios.ped_half),
            dim=-1,
        )
        walk = walk.masked_fill(~scenarios.ped_present[..., None], torch.nan)
        rows["walk"][worlds] = torch.nan
        rows["walk"][worlds, :count] = walk[row, order]
        rows["route"][worlds, :count] = scenarios.route[row, order]
        rows["route_arc"][worlds, :count] = scenarios.route_arc[row, order]
        place_pedestrians_kernel(
            worlds,
            *(rows[name] for name in ("boxes", "route", "route_arc", "walk", "tick")),
            self._timing[0],
        )

    def _check_last_commands(self) -> None:
        """Raise what :meth:`step` could not on a device without waiting for it."""
        if self.device.type == "cpu" or bool(self._all_finite):
            return
        self._all_finite.fill_(True)
        raise ValueError("command must be finite, got NaN or infinity since the last reset")

    def _finite(self, command: Tensor) -> Tensor:
        """Return a device's command with zeros for what is not finite, and take note of that."""
        if self.device.type == "cpu":
            return command
        self._all_finite.logical_and_(torch.isfinite(command).all())
        return torch.nan_to_num(command, nan=0.0, posinf=0.0, neginf=0.0)

    def step(self, command: Tensor) -> SimState:
        self.check_command(command)
        if not self._is_ready:
            raise RuntimeError("every world must be reset before the first step")
        rows = self._rows
        step_worlds_kernel(
            *(rows[name] for name in ("pose", "velocity", "tick", "contact")),
            self._finite(command).double().contiguous(),
            self._drive,
            self._timing,
            *(rows[name] for name in ("walls", "num_walls", "route", "route_arc", "walk", "boxes")),
            self._near,
        )
        return self.state()

    def state(self) -> SimState:
        rows = self._rows
        return SimState(
            pose=rows["pose"].float(),
            velocity=rows["velocity"].float(),
            contact=rows["contact"].clone(),
            pedestrians=rows["boxes"].float(),
            time_s=(rows["tick"] * self._timing[0]).float(),
        )

    def ranges(self, worlds: Tensor | None = None) -> Tensor:
        worlds = self._every_world if worlds is None else worlds.to(self.device)
        if not self._is_ready and bool(self._rows["pose"][worlds].isnan().any()):
            raise RuntimeError("every world must be reset before the first scan")
        out = torch.empty(len(worlds), self.lidar.num_beams, device=self.device)
        rows = self._rows
        scan_worlds_kernel(
            out,
            worlds,
            rows["pose"],
            self._mount,
            *(rows[name] for name in ("walls", "num_walls", "boxes")),
            *self._beams,
            self.lidar.max_range,
        )
        return out

    def walls(self, world: int) -> Tensor:
        rows = self._rows
        if bool(rows["pose"][world].isnan().any()):
            raise RuntimeError(f"world {world} must be reset first")
        walls = rows["walls"][world, : int(rows["num_walls"][world])]
        yaw = torch.atan2(walls[:, 5], walls[:, 4])
        return torch.cat((walls[:, :4], yaw[:, None]), dim=-1)

    def state_dict(self) -> dict[str, Tensor]:
        return {name: rows.clone() for name, rows in self._rows.items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        if state.keys() != self._rows.keys():
            raise ValueError(f"state must have the keys {sorted(self._rows)}, got {sorted(state)}")
        for name, rows in self._rows.items():
            wanted, got = list(rows.shape), list(state[name].shape)
            if name == "walls":
                wanted[1] = got[1] if len(got) == 3 else -1
            if wanted != got:
                raise ValueError(f"state[{name!r}] must be {wanted}, got {got}")
        self._rows = {
            name: state[name].to(self.device, rows.dtype, copy=True)
            for name, rows in self._rows.items()
        }
        self._is_ready = not bool(self._rows["pose"].isnan().any())
        self._make_scratch()


def _packed_walls(scenarios: ScenarioBatch) -> Tensor:
    """Return [M, W, 6] (cx, cy, hx, hy, cos yaw, sin yaw)."""
    boxes = scenarios.boxes.double()
    yaw = boxes[..., 4:5]
    return torch.cat((boxes[..., :4], torch.cos(yaw), torch.sin(yaw)), dim=-1)
