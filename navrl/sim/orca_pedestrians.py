"""Pedestrians that avoid each other, walls and perhaps the robot by ORCA."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from navrl.checks import check_positive
from navrl.sim.rvo import corners, import_rvo
from navrl.sim.walkers import RouteWalkers

if TYPE_CHECKING:
    from navrl.sim.state import SimState
    from navrl.worlds import ScenarioBatch

RVOSimulator = Any  # pyrvo is an extra, and has no annotations
_AWAY_M = 1e4  # m, position of absent pedestrians, and of a robot that is not seen
_MAX_SPEED_SHARE = 1.3  # of the preferred speed, to which a pedestrian may hurry


class OrcaPedestrians(RouteWalkers):
    """Reactive pedestrians on their routes, with optimal reciprocal collision avoidance.

    Each assumes that the others, the robot included, do half of the avoidance. The widest
    swing of feet among those that react in a world is kept from the robot by all of them.

    Args:
        sees_robot: Whether pedestrians avoid the robot.
        robot_radius: Of the hull, m.
        margin: Distance that pedestrians keep from others and the robot, m.
        time_horizon: Time within which contacts with others are avoided, s.
        wall_horizon: Time within which contacts with walls are avoided, s.
        sidestep: Angle to the right of the preferred velocity, see :class:`RouteWalkers`, rad.
        share: Share of the episodes in which pedestrians react, see :class:`RouteWalkers`.

    Raises:
        ImportError: If ``pyrvo`` is not installed.
        ValueError: If a value is out of range.

    Reference:
        Van den Berg et al., "Reciprocal n-body collision avoidance", 2011; pedestrians of iGibson
        in the paper's Table I c.
    """

    def __init__(
        self,
        sees_robot: bool = True,
        robot_radius: float = 0.178,
        margin: float = 0.05,
        time_horizon: float = 2.0,
        wall_horizon: float = 0.5,
        sidestep: float = 0.05,
        share: float = 1.0,
    ) -> None:
        """Check the values."""
        super().__init__(sidestep, share)
        check_positive(
            robot_radius=robot_radius, time_horizon=time_horizon, wall_horizon=wall_horizon
        )
        if not margin >= 0:
            raise ValueError(f"margin={margin}: must be >= 0 m")
        self._rvo = import_rvo("pedestrians=orca")
        self.sees_robot, self.robot_radius, self.margin = sees_robot, robot_radius, margin
        self.time_horizon, self.wall_horizon = time_horizon, wall_horizon
        self._worlds: dict[int, RVOSimulator] = {}

    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        """Start episodes; see :meth:`navrl.sim.PedestrianModel.reset`."""
        super().reset(worlds, scenarios)
        for world in worlds.tolist():
            self._worlds.pop(world, None)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore a state of :meth:`state_dict`."""
        super().load_state_dict(state)
        self._worlds.clear()

    def velocities(
        self,
        state: SimState,
        place: Tensor,
        preferred: Tensor,
        rows: dict[str, Tensor],
        duration_s: float,
    ) -> Tensor:
        """Return the velocities of ORCA, [N, K, 2] m/s."""
        yaw, speed = state.pose[:, 2].double().cpu(), state.velocity[:, 0].double().cpu()
        robot = torch.stack((speed * yaw.cos(), speed * yaw.sin()), dim=-1)
        values = (
            (state.contact == 0).tolist(),
            state.pose[:, :2].tolist(),
            robot.tolist(),
            place.nan_to_num(_AWAY_M).tolist(),
            rows["velocity"].tolist(),
            preferred.nan_to_num(0.0).tolist(),
            rows["walks"].tolist(),
        )
        found = torch.zeros_like(place)
        for world, row in enumerate(zip(*values, strict=True)):
            if row[0] and any(row[-1]):
                simulation = self._simulation(world, rows, duration_s)
                found[world] = torch.tensor(self._solve(simulation, *row[1:]), dtype=found.dtype)
        return found

    def _simulation(self, world: int, rows: dict[str, Tensor], duration_s: float) -> RVOSimulator:
        """Return the RVO2 simulation of a world: walls, the robot, then its pedestrians."""
        if world in self._worlds:
            return self._worlds[world]
        reach = 10.0  # m, beyond all that is within the time horizon
        count = rows["speed"].shape[1]
        common = (reach, count + 1, self.time_horizon, self.wall_horizon)
        simulation = self._rvo.RVOSimulator(duration_s, *common, self.robot_radius, 10.0)
        for wall in corners(rows["walls"][world, : int(rows["num_walls"][world])]).tolist():
            simulation.add_obstacle(wall)
        simulation.process_obstacles()
        feet = float(rows["feet"][world].amax())  # m, of those that react
        simulation.add_agent((_AWAY_M, 0.0), *common, self.robot_radius + feet, 10.0)
        for radius, speed in zip(
            rows["radius"][world].tolist(), rows["speed"][world].tolist(), strict=True
        ):
            fastest = max(_MAX_SPEED_SHARE * speed, 1e-3)
            simulation.add_agent((_AWAY_M, _AWAY_M), *common, radius + self.margin, fastest)
        self._worlds[world] = simulation
        return simulation

    def _solve(
        self,
        simulation: RVOSimulator,
        pose: list[float],
        velocity: list[float],
        places: list,
        velocities: list,
        preferred: list,
        walks: list[bool],
    ) -> list[tuple[float, float]]:
        """Return the velocity of each pedestrian of a world, m/s."""
        seen = pose if self.sees_robot else (-_AWAY_M, -_AWAY_M)
        agents = [(seen, velocity, velocity)]
        for index in range(len(places)):
            wanted = preferred[index] if walks[index] else velocities[index]
            agents.append((places[index], velocities[index], wanted))
        for index, (at, now, wanted) in enumerate(agents):
            simulation.set_agent_position(index, tuple(at))
            simulation.set_agent_velocity(index, tuple(now))
            simulation.set_agent_pref_velocity(index, tuple(wanted))
        simulation.do_step()
        return [simulation.get_agent_velocity(k + 1).to_tuple() for k in range(len(places))]
