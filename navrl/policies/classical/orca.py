"""Optimal reciprocal collision avoidance among people who do not reciprocate, with true states."""

from __future__ import annotations

import math
from types import ModuleType

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from navrl import keys
from navrl.extras import install_hint
from navrl.ops import se2
from navrl.policies.classical.commands import normalized_action, physical_command
from navrl.sim import DifferentialDrive
from navrl.worlds import ScenarioBatch

PREVIOUS_BOXES = "pedestrian_boxes_previous"  # [N, K, 5], what this controller saw a step ago
_ROBOT = 0  # its number in RVO2; people follow
_NOWHERE = 1e4  # m, where people are who are not there


class Orca(TensorDictModuleBase):
    """Follow the waypoints with the velocity nearest to the wanted one that touches nobody.

    It cheats: it reads the walls and the true boxes of the pedestrians, and their velocities by
    difference. The geometry and the linear program are RVO2's. RVO2 lets each of two agents take
    half of the avoidance, but these pedestrians take none; so a step is solved again from the
    velocity it gave, ``iterations`` times, each halving what is still missing. Pedestrians are
    discs around their cuboids, walls are RVO2's obstacles. The robot turns to the velocity it is
    given and drives on as far as it faces it.

    Args:
        robot: Whose hull and limits count.
        waypoint: Index of the waypoint driven to.
        time_step_s: s.
        time_horizon: s that people are avoided ahead.
        wall_horizon: s that walls are avoided ahead.
        margin: m kept off people beside the discs.
        iterations: RVO2 steps solved for one.
        sidestep: rad that the wanted velocity points to the left of the waypoint, so that somebody
            who stands exactly in between does not hold the robot for ever.

    Raises:
        ImportError: If RVO2's binding is not installed.
        ValueError: If a value is out of range.

    Reference:
        Van den Berg et al., "Reciprocal n-body collision avoidance", 2011; RVO2 2.0.3 by pyrvo.
        Full instead of half avoidance and the drive of a unicycle are ours.
    """

    def __init__(
        self,
        robot: DifferentialDrive,
        waypoint: int = 1,
        time_step_s: float = 0.2,
        time_horizon: float = 2.0,
        wall_horizon: float = 0.4,
        margin: float = 0.1,
        iterations: int = 8,
        sidestep: float = 0.05,
    ) -> None:
        super().__init__()
        positive = {
            "time_step_s": time_step_s,
            "time_horizon": time_horizon,
            "wall_horizon": wall_horizon,
            "iterations": iterations,
        }
        for name, value in positive.items():
            if not value > 0:
                raise ValueError(f"{name}={value}: must be > 0")
        if waypoint < 0 or margin < 0 or not abs(sidestep) < math.pi / 2:
            raise ValueError(
                f"waypoint={waypoint}, margin={margin}: must be >= 0; "
                f"sidestep={sidestep}: must be within +-pi/2 rad"
            )
        self._rvo = _import_rvo()
        self.in_keys = [keys.POSE, keys.WAYPOINTS, keys.PEDESTRIAN_BOXES]
        self.out_keys = [keys.ACTION, PREVIOUS_BOXES]
        self.robot, self.waypoint, self.time_step_s = robot, waypoint, time_step_s
        self.time_horizon, self.wall_horizon = time_horizon, wall_horizon
        self.margin, self.iterations, self.sidestep = margin, iterations, sidestep
        self._worlds: list = []

    def prepare(self, scenarios: ScenarioBatch) -> None:
        """Read the walls of the worlds that are played next, ``[N]``."""
        corners = _corners(scenarios.boxes).tolist()
        people = scenarios.ped_half.norm(dim=-1).amax(-1).tolist()
        count = scenarios.num_boxes.tolist()
        self._worlds = [
            self._make_world(corners[n][: count[n]], people[n]) for n in range(len(scenarios))
        ]

    def _make_world(self, walls: list, person_radius: float) -> object:
        """Return a simulator of RVO2 with the walls and the robot in it."""
        robot = self.robot
        reach = 2 * robot.max_speed * self.time_horizon + 1.0  # m, whom the robot may meet in time
        world = self._rvo.RVOSimulator(
            self.time_step_s, reach, 0, 0.1, 0.1, person_radius + self.margin, 10.0
        )  # as people are: they mind nobody
        for wall in walls:
            world.add_obstacle(wall)
        world.process_obstacles()
        world.add_agent(
            (0.0, 0.0), reach, 16, self.time_horizon, self.wall_horizon,
            robot.radius, robot.max_speed,
        )  # fmt: skip
        return world

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalised action ``[N, 2]``.

        Raises:
            RuntimeError: If nothing was prepared for these worlds.
            ValueError: If there is no such waypoint.
        """
        pose, waypoints, boxes = (tensordict.get(key) for key in self.in_keys)
        if len(self._worlds) != len(pose):
            raise RuntimeError(
                f"orca: call prepare() with the scenarios of these {len(pose)} worlds"
            )
        if self.waypoint >= waypoints.shape[-2]:
            raise ValueError(f"waypoint={self.waypoint}: there are {waypoints.shape[-2]} waypoints")
        before = tensordict.get(PREVIOUS_BOXES, boxes)
        velocity = ((boxes - before)[..., :2] / self.time_step_s).nan_to_num(0.0)
        place = boxes[..., :2].nan_to_num(_NOWHERE)
        yaw = pose[:, 2]
        wanted = se2.rotate(self._wanted(waypoints[:, self.waypoint]), yaw)
        now = se2.rotate(self._driven(tensordict), yaw)
        rows = zip(
            self._worlds, *(v.tolist() for v in (pose, now, wanted, place, velocity)), strict=True
        )
        chosen = se2.rotate(pose.new_tensor([self._solve(*row) for row in rows]), -yaw)
        tensordict.set(PREVIOUS_BOXES, boxes)
        return tensordict.set(keys.ACTION, normalized_action(self.robot, self._command(chosen)))

    def _wanted(self, waypoint: Tensor) -> Tensor:
        """Return ``[N, 2]`` m/s, robot frame: to the waypoint, a little to the left of it."""
        distance = waypoint.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        angle = torch.full_like(waypoint[:, 0], self.sidestep)
        return se2.rotate(self.robot.max_speed * waypoint / distance, angle)

    def _driven(self, tensordict: TensorDictBase) -> Tensor:
        """Return ``[N, 2]`` m/s, robot frame, as last commanded."""
        velocity = torch.zeros(len(self._worlds), 2, device=tensordict.device)
        action = tensordict.get(keys.ACTION, None)
        if action is not None:
            velocity[:, 0] = physical_command(self.robot, action)[:, 0]
        return velocity

    def _solve(
        self, world: object, pose: list, velocity: list, wanted: list, places: list, speeds: list
    ) -> tuple[float, float]:
        """Return the velocity that avoids all by itself, m/s, world frame."""
        for _ in range(len(places) + 1 - world.get_num_agents()):
            world.add_agent((_NOWHERE, _NOWHERE))
        for _ in range(self.iterations):
            world.set_agent_position(_ROBOT, pose[:2])
            world.set_agent_velocity(_ROBOT, velocity)
            world.set_agent_pref_velocity(_ROBOT, wanted)
            for person, (place, speed) in enumerate(zip(places, speeds, strict=True), start=1):
                world.set_agent_position(person, place)
                world.set_agent_velocity(person, speed)
                world.set_agent_pref_velocity(person, speed)
            world.do_step()
            velocity = world.get_agent_velocity(_ROBOT).to_tuple()
        return velocity

    def _command(self, velocity: Tensor) -> Tensor:
        """Return ``[N, 2]`` (v, w): turn to the velocity, drive as far as it lies ahead."""
        x, y = velocity.unbind(-1)
        turn = torch.atan2(y, x) / self.time_step_s
        stands = velocity.norm(dim=-1) < 0.02 * self.robot.max_speed  # no direction worth a turn
        return torch.stack([x.clamp_min(0.0), turn.masked_fill(stands, 0.0)], dim=-1)


def _corners(boxes: Tensor) -> Tensor:
    """Return ``[..., 4, 2]`` m, counter-clockwise, of boxes ``[..., 5]``."""
    signs = boxes.new_tensor([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    offsets = signs * boxes[..., None, 2:4]
    return boxes[..., None, :2] + se2.rotate(offsets, boxes[..., 4:])


def _import_rvo() -> ModuleType:
    try:
        import pyrvo
    except ImportError as error:
        raise ImportError(
            f"policy=orca: needs pyrvo (RVO2, Apache-2.0); {install_hint('orca')}"
        ) from error
    return pyrvo
