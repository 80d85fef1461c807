"""Optimal reciprocal collision avoidance (ORCA) among non-reactive pedestrians."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from navrl import keys
from navrl.checks import check_positive
from navrl.ops import se2
from navrl.policies.classical.commands import last_command, normalized_action
from navrl.policies.controller import Controller
from navrl.sim import DifferentialDrive
from navrl.sim.rvo import corners, import_rvo
from navrl.worlds import ScenarioBatch

RVOSimulator = Any  # pyrvo is an extra, and has no annotations
PREVIOUS_BOXES = "pedestrian_boxes_previous"  # [N, K, 5], boxes of the previous step
_ROBOT = 0  # index in RVO2; pedestrians follow
_ABSENT_M = 1e4  # m, position of absent pedestrians


class Orca(Controller):
    """Follow the waypoints with the collision-free velocity closest to the preferred one.

    The controller is privileged: it reads the walls and the true boxes of the pedestrians, and
    their velocities by difference. The geometry and the linear program are RVO2's. RVO2 shares the
    avoidance equally between two agents, but these pedestrians are non-reactive; so a step is
    solved ``iterations`` times, each from the last solution, which halves the missing avoidance.
    The first starts from the robot's last command. Pedestrians are discs around their cuboids,
    walls are RVO2's obstacles. The robot turns towards the velocity and drives with its component
    along the heading; this arc deviates from the straight line that RVO2 checks, which
    ``wall_margin`` accounts for.

    Args:
        robot: Hull and limits.
        waypoint: Index of the target waypoint.
        time_step_s: Time between two commands, s.
        time_horizon: Time within which contacts with pedestrians are avoided, s.
        wall_horizon: Time within which contacts with walls are avoided, s.
        margin: Minimum distance between the hull and the pedestrians' discs, m.
        wall_margin: Minimum distance between the hull and walls, m.
        iterations: RVO2 solutions per step.
        sidestep: Angle of the preferred velocity to the left of the waypoint, rad, so that a
            stationary pedestrian exactly in between does not block the robot.

    Raises:
        ImportError: If RVO2's binding is not installed.
        ValueError: If a value is out of range.

    Reference:
        Van den Berg et al., "Reciprocal n-body collision avoidance", 2011; RVO2 2.0.3 by pyrvo.
        Full instead of half avoidance and the unicycle motion are ours.
    """

    privileged = True
    requires = ("pyrvo",)

    def __init__(
        self,
        robot: DifferentialDrive,
        waypoint: int = 1,
        time_step_s: float = 0.2,
        time_horizon: float = 2.0,
        wall_horizon: float = 0.4,
        margin: float = 0.1,
        wall_margin: float = 0.05,
        iterations: int = 8,
        sidestep: float = 0.05,
    ) -> None:
        super().__init__()
        check_positive(
            time_step_s=time_step_s,
            time_horizon=time_horizon,
            wall_horizon=wall_horizon,
            iterations=iterations,
        )
        at_least_zero = {"waypoint": waypoint, "margin": margin, "wall_margin": wall_margin}
        for name, value in at_least_zero.items():
            if not value >= 0:
                raise ValueError(f"{name}={value}: must be >= 0")
        if not abs(sidestep) < math.pi / 2:
            raise ValueError(f"sidestep={sidestep}: must be within +-pi/2 rad")
        self._rvo = import_rvo("policy=orca")
        self.in_keys = [keys.POSE, keys.WAYPOINTS, keys.PEDESTRIAN_BOXES]
        self.out_keys = [keys.ACTION, PREVIOUS_BOXES]
        self.robot, self.waypoint, self.time_step_s = robot, waypoint, time_step_s
        self.time_horizon, self.wall_horizon = time_horizon, wall_horizon
        self.margin, self.wall_margin = margin, wall_margin
        self.iterations, self.sidestep = iterations, sidestep
        self._worlds: list = []

    def prepare(self, scenarios: ScenarioBatch) -> None:
        """Read the walls and the pedestrians' speeds of the next episodes, ``[N]``."""
        scenarios = scenarios.touchable(self.robot.height)
        outlines = corners(scenarios.boxes).tolist()
        count = scenarios.num_boxes.tolist()
        here = scenarios.ped_present
        radius = scenarios.ped_half.norm(dim=-1).masked_fill(~here, 0.0).amax(-1).tolist()
        speed = scenarios.ped_speed.masked_fill(~here, 0.0).amax(-1).tolist()
        self._worlds = [
            self._make_world(outlines[n][: count[n]], radius[n], speed[n], here.shape[-1])
            for n in range(len(scenarios))
        ]

    def _make_world(
        self, walls: list, person_radius: float, person_speed: float, max_people: int
    ) -> RVOSimulator:
        """Return an RVO2 simulator with the walls and the robot.

        An agent of RVO2 has one radius for all obstacles. The robot's includes ``wall_margin``; the
        pedestrians' radii include the rest of their margin.
        """
        robot = self.robot
        gap = robot.radius + person_radius + self.margin  # m between centers at a contact
        reach = (robot.max_speed + person_speed) * self.time_horizon + gap
        hull = robot.radius + self.wall_margin
        world = self._rvo.RVOSimulator(
            self.time_step_s, reach, 0, 0.1, 0.1, gap - hull, 10.0
        )  # defaults for the non-reactive pedestrians: 0 neighbors
        for wall in walls:
            world.add_obstacle(wall)
        world.process_obstacles()
        world.add_agent(
            (0.0, 0.0), reach, max(1, max_people), self.time_horizon, self.wall_horizon,
            hull, robot.max_speed,
        )  # fmt: skip
        return world

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the normalized action ``[N, 2]``.

        Raises:
            RuntimeError: If nothing was prepared for these worlds.
            ValueError: If ``waypoint`` exceeds the number of waypoints.
        """
        pose, waypoints, boxes = (tensordict.get(key) for key in self.in_keys)
        if len(self._worlds) != len(pose):
            raise RuntimeError(
                f"orca: call prepare() with the scenarios of these {len(pose)} worlds"
            )
        if self.waypoint >= waypoints.shape[-2]:
            raise ValueError(
                f"waypoint={self.waypoint}: must be < {waypoints.shape[-2]}, the waypoints"
            )
        before = tensordict.get(PREVIOUS_BOXES, boxes)
        velocity = ((boxes - before)[..., :2] / self.time_step_s).nan_to_num(0.0)
        place = boxes[..., :2].nan_to_num(_ABSENT_M)
        yaw = pose[:, 2]
        preferred = se2.rotate(self._preferred_velocity(waypoints[:, self.waypoint]), yaw)
        forward = last_command(self.robot, tensordict)[:, :1]
        now = se2.rotate(torch.cat([forward, torch.zeros_like(forward)], -1), yaw)
        rows = zip(
            self._worlds,
            *(v.tolist() for v in (pose, now, preferred, place, velocity)),
            strict=True,
        )
        chosen = se2.rotate(pose.new_tensor([self._solve(*row) for row in rows]), -yaw)
        tensordict.set(PREVIOUS_BOXES, boxes)
        return tensordict.set(keys.ACTION, normalized_action(self.robot, self._command(chosen)))

    def _preferred_velocity(self, waypoint: Tensor) -> Tensor:
        """Return the preferred velocity ``[N, 2]`` m/s, robot frame."""
        distance = waypoint.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        angle = torch.full_like(waypoint[:, 0], self.sidestep)
        return se2.rotate(self.robot.max_speed * waypoint / distance, angle)

    def _solve(
        self,
        world: RVOSimulator,
        pose: list,
        velocity: Sequence[float],
        preferred: list,
        places: list,
        speeds: list,
    ) -> Sequence[float]:
        """Return the velocity with full avoidance, m/s, world frame."""
        for _ in range(len(places) + 1 - world.get_num_agents()):
            world.add_agent((_ABSENT_M, _ABSENT_M))
        for _ in range(self.iterations):
            world.set_agent_position(_ROBOT, pose[:2])
            world.set_agent_velocity(_ROBOT, velocity)
            world.set_agent_pref_velocity(_ROBOT, preferred)
            for person, (place, speed) in enumerate(zip(places, speeds, strict=True), start=1):
                world.set_agent_position(person, place)
                world.set_agent_velocity(person, speed)
                world.set_agent_pref_velocity(person, speed)
            world.do_step()
            velocity = world.get_agent_velocity(_ROBOT).to_tuple()
        return velocity

    def _command(self, velocity: Tensor) -> Tensor:
        """Return ``[N, 2]`` (v, w): turn towards the velocity, drive its forward component."""
        x, y = velocity.unbind(-1)
        turn = torch.atan2(y, x) / self.time_step_s
        is_slow = velocity.norm(dim=-1) < 0.02 * self.robot.max_speed  # too slow for a direction
        return torch.stack([x.clamp_min(0.0), turn.masked_fill(is_slow, 0.0)], dim=-1)
