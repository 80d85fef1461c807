"""Pedestrian models: motion of the pedestrians during a control step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from navrl.sim.state import SimState
    from navrl.worlds import ScenarioBatch

_SMALLEST_STEP = 1e-6  # m; a pedestrian that moves less retains its heading


class PedestrianModel(ABC):
    """Base class of pedestrian models, which set the targets of all pedestrians once per step.

    A simulator calls :meth:`reset` when worlds begin an episode, after it has placed each
    pedestrian at the start of its scripted route, and :meth:`targets` before each step. During a
    step a pedestrian walks in a straight line at constant speed and faces along it.

    Attributes:
        is_reactive: Whether pedestrians may leave the routes of their scenario. A simulator does
            not call a non-reactive model, for which future positions are known.
    """

    is_reactive: bool = True

    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:  # noqa: B027, may be empty
        """Start episodes.

        Args:
            worlds: [M] int64, worlds that start an episode.
            scenarios: M scenarios; present pedestrians come first, in the order of
                :attr:`SimState.pedestrians`.
        """

    @abstractmethod
    def targets(self, state: SimState, duration_s: float) -> Tensor:
        """Return the centers of the pedestrians at the end of the step.

        Args:
            state: State of all worlds at the start of the step. Worlds in contact do not move.
            duration_s: Duration of the step, s.

        Returns:
            [N, K, 2] m, world. With NaN a pedestrian follows its scripted route, which must hold
            for the whole episode, because the route is a function of time only.
        """

    def state_dict(self) -> dict[str, Tensor]:
        """Return the state that :meth:`load_state_dict` needs to continue bit for bit."""
        return {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:  # noqa: B027, may be empty
        """Continue from a state of :meth:`state_dict`."""


class ScriptedRoutes(PedestrianModel):
    """Non-reactive pedestrians that walk back and forth on the routes of their scenario.

    Reference:
        Paper Sec. IV-F: pedestrians that do not give way.
    """

    is_reactive = False

    def targets(self, state: SimState, duration_s: float) -> Tensor:
        """Return NaN for each pedestrian, so that it follows its route."""
        return torch.full_like(state.pedestrians[..., :2], torch.nan)


def step_legs(boxes: Tensor, targets: Tensor) -> Tensor:
    """Return the line segment on which each pedestrian walks during a step.

    Args:
        boxes: [N, K, 5] float64 (cx, cy, hx, hy, yaw) at the start of the step, world; NaN rows are
            absent.
        targets: [N, K, 2] m, centers at the end of the step; NaN rows follow their scripted route.

    Returns:
        [N, K, 5] float64 (x, y at the start, x, y at the end, yaw); NaN rows have no segment.

    Raises:
        ValueError: If the shape of ``targets`` is not ``[N, K, 2]`` or a value is infinite.
    """
    if targets.shape != (*boxes.shape[:2], 2) or bool(targets.isinf().any()):
        raise ValueError(
            f"targets: must be {[*boxes.shape[:2], 2]} with NaN or finite numbers, "
            f"got {list(targets.shape)}"
        )
    start, end = boxes[..., :2], targets.to(boxes)
    x, y = (end - start).unbind(-1)
    is_still = torch.sqrt(x * x + y * y) < _SMALLEST_STEP
    yaw = torch.where(is_still, boxes[..., 4], torch.atan2(y, x))
    legs = torch.cat((start, end, yaw[..., None]), dim=-1)
    return legs.masked_fill(~torch.isfinite(legs).all(-1, keepdim=True), torch.nan)


def boxes_along(legs: Tensor, boxes: Tensor, scripted: Tensor, shares: Tensor) -> Tensor:
    """Return the boxes of pedestrians at several times within a step.

    Args:
        legs: [N, K, 5], see :func:`step_legs`.
        boxes: [N, K, 5], boxes at the start of the step.
        scripted: [N, S, K, 5], boxes of pedestrians without a leg.
        shares: [S], elapsed fractions of the step, in [0, 1].

    Returns:
        [N, S, K, 5] float64 boxes, world.
    """
    share = shares[:, None, None]
    center = legs[:, None, :, :2] + share * (legs[:, None, :, 2:4] - legs[:, None, :, :2])
    size = boxes[:, None, :, 2:4].expand_as(center)
    yaw = legs[:, None, :, 4:].expand(*center.shape[:-1], 1)
    walked = torch.cat((center, size, yaw), dim=-1)
    return torch.where(legs[:, None, :, :1].isnan(), scripted, walked)
