"""Base class of reactive pedestrians that walk back and forth on their routes."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from navrl.ops.bodies import BODY_BOX, BODY_HEIGHT_M, BODY_LEGS
from navrl.ops.gait import MAX_STRIDE, step_length
from navrl.sim.crowd import PedestrianModel
from navrl.sim.draws import Uniform, draw

if TYPE_CHECKING:
    from navrl.sim.state import SimState
    from navrl.worlds import ScenarioBatch

_ARRIVED_M = 0.4  # m from a point of the route, from which a pedestrian walks to the next one
_NUMBERS = {"forth": torch.bool, "walks": torch.bool, "toward": torch.int64, "last": torch.int64}
_NUMBERS["num_walls"] = torch.int64
_SHAPES = {  # without the first axis, the worlds
    "walls": (0, 5),
    "num_walls": (),
    "route": (0, 0, 2),
    "last": (0,),
    "toward": (0,),
    "forth": (0,),
    "walks": (0,),
    "speed": (0,),
    "radius": (0,),
    "feet": (0,),
    "velocity": (0, 2),
}


class RouteWalkers(PedestrianModel):
    """Base class of models in which each pedestrian wants to walk along its route and reacts.

    Stationary pedestrians and those with a track do not react: they follow their scenario. A
    subclass returns velocities from :meth:`velocities`.

    Args:
        sidestep: Angle by which the preferred velocity is turned to the right, rad, which resolves
            encounters head-on.
        share: Share of the episodes in which pedestrians react, drawn from each scenario's
            ``noise_seed``; in the others they follow their routes.

    Attributes:
        rows: State of N worlds with K pedestrians: ``walls`` [N, W, 5] and ``num_walls`` [N],
            ``route`` [N, K, R, 2], ``last`` [N, K] index of its last point, ``toward`` [N, K] index
            of the next point, ``forth`` [N, K] whether indices increase, ``walks`` [N, K] whether
            the pedestrian reacts, ``speed``, ``radius`` [N, K] and ``velocity`` [N, K, 2].

    Raises:
        ValueError: If a value is out of range.
    """

    def __init__(self, sidestep: float = 0.0, share: float = 1.0) -> None:
        """Check the values and create empty rows."""
        if not abs(sidestep) < math.pi / 2:
            raise ValueError(f"sidestep={sidestep}: must be within +-pi/2 rad")
        if not 0 <= share <= 1:
            raise ValueError(f"share={share}: must be in [0, 1]")
        self.sidestep, self.share = sidestep, share
        self.rows = {
            name: torch.zeros(0, *shape, dtype=_NUMBERS.get(name, torch.float64))
            for name, shape in _SHAPES.items()
        }

    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:
        """Start episodes; see :meth:`navrl.sim.PedestrianModel.reset`."""
        solid = scenarios.touchable(BODY_HEIGHT_M)
        arc, half = scenarios.route_arc, scenarios.ped_half
        phase = torch.remainder(scenarios.ped_offset, (2.0 * arc[..., -1]).clamp_min(1e-9))
        forth = phase <= arc[..., -1]
        along = torch.where(forth, phase, 2.0 * arc[..., -1] - phase)
        after = (arc <= along[..., None]).sum(-1)
        last = (arc < arc[..., -1:]).sum(-1)
        is_round = scenarios.ped_body != BODY_BOX
        walks = scenarios.ped_present & ~scenarios.ped_static & ~scenarios.ped_tracked
        if self.share < 1.0:
            drawn = draw("reacts", Uniform(0.0, 1.0), scenarios.noise_seed)
            walks = walks & (drawn < self.share)[:, None]
        values = {
            "walls": solid.boxes.double(),
            "num_walls": solid.num_boxes,
            "route": scenarios.route,
            "last": last,
            "toward": torch.minimum(torch.where(forth, after, after - 1).clamp_min(0), last),
            "forth": forth,
            "walks": walks,
            "speed": scenarios.ped_speed,
            "radius": torch.where(is_round, half[..., 0], half.norm(dim=-1)),
            "feet": torch.where(walks, _feet(scenarios), 0.0),
            "velocity": torch.zeros_like(half),
        }
        for name, value in values.items():
            self._put(name, worlds.cpu(), value.cpu())

    def _put(self, name: str, worlds: Tensor, value: Tensor) -> None:
        """Write rows; there are more rows and columns if necessary."""
        rows = self.rows[name]
        wanted = [int(worlds.max()) + 1, *value.shape[1:]]
        shape = [max(pair) for pair in zip(rows.shape, wanted, strict=True)]
        if list(rows.shape) != shape:
            larger = torch.zeros(shape, dtype=rows.dtype)
            larger[tuple(slice(size) for size in rows.shape)] = rows
            rows = self.rows[name] = larger
        rows[worlds] = 0
        rows[(worlds, *(slice(size) for size in value.shape[1:]))] = value.to(rows.dtype)

    def targets(self, state: SimState, duration_s: float) -> Tensor:
        """Return the pedestrians' centers after the step; NaN for those that do not react."""
        place = state.pedestrians[..., :2].double().cpu()
        rows = {name: value[: len(place)] for name, value in self.rows.items()}
        self._advance(place, rows)
        point = rows["route"].gather(2, rows["toward"][..., None, None].expand(-1, -1, 1, 2))
        offset = point.squeeze(2) - place
        distance = offset.norm(dim=-1, keepdim=True).clamp_min(1e-6)
        preferred = rows["speed"][..., None] * offset / distance
        cos, sin = math.cos(self.sidestep), math.sin(self.sidestep)
        x, y = preferred.unbind(-1)
        preferred = torch.stack((cos * x + sin * y, cos * y - sin * x), dim=-1)  # to the right
        is_here = ~place.isnan().any(-1)
        reacts = rows["walks"] & is_here
        velocity = self.velocities(state, place, preferred, rows, duration_s)
        self.rows["velocity"][: len(place)] = velocity.masked_fill(~reacts[..., None], 0.0)
        target = place + duration_s * velocity
        target = target.masked_fill(~reacts[..., None], torch.nan)
        return target.to(state.pedestrians.device)

    def _advance(self, place: Tensor, rows: dict[str, Tensor]) -> None:
        """Choose the next point of the route of each pedestrian that has arrived."""
        toward, forth, last = rows["toward"], rows["forth"], rows["last"]
        point = rows["route"].gather(2, toward[..., None, None].expand(-1, -1, 1, 2)).squeeze(2)
        arrived = (point - place).norm(dim=-1) < _ARRIVED_M  # False where absent
        turns = arrived & torch.where(forth, toward >= last, toward <= 0)
        forth = forth ^ turns
        step = torch.where(forth, 1, -1)
        toward = torch.where(arrived, toward + step, toward).clamp_min(0)
        self.rows["forth"][: len(place)] = forth
        self.rows["toward"][: len(place)] = rows["toward"] = torch.minimum(toward, last)

    @abstractmethod
    def velocities(
        self,
        state: SimState,
        place: Tensor,
        preferred: Tensor,
        rows: dict[str, Tensor],
        duration_s: float,
    ) -> Tensor:
        """Return the velocities of all pedestrians in the next step.

        Args:
            state: State of all worlds.
            place: [N, K, 2] float64 centers, m; NaN where absent.
            preferred: [N, K, 2] velocities along the routes, turned by ``sidestep``, m/s.
            rows: Rows of these worlds; ``velocity`` is that of the last step.
            duration_s: Duration of the step, s.

        Returns:
            [N, K, 2] m/s; values of pedestrians that do not react are ignored.
        """

    def state_dict(self) -> dict[str, Tensor]:
        """Return copies of all rows."""
        return {name: rows.clone() for name, rows in self.rows.items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the rows of :meth:`state_dict`.

        Raises:
            ValueError: If a key is missing.
        """
        missing = sorted(self.rows.keys() - state.keys())
        if missing:
            raise ValueError(f"state: lacks {missing} of the pedestrians")
        self.rows = {name: state[name].cpu().clone() for name in self.rows}


def _feet(scenarios: ScenarioBatch) -> Tensor:
    """Return how far the feet of pedestrians with legs swing beyond their bodies, [N, K] m."""
    stride = MAX_STRIDE * step_length(scenarios.ped_speed) + scenarios.ped_leg_radius
    beyond = (stride - scenarios.ped_half[..., 0]).clamp_min(0.0)
    return torch.where(scenarios.ped_body == BODY_LEGS, beyond, 0.0)
