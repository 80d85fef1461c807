"""Pedestrian models: where each pedestrian goes during the next control step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from navrl.sim.state import SimState
    from navrl.worlds import ScenarioBatch

_SMALLEST_STEP = 1e-6  # m; a pedestrian that moves less keeps the direction it faces


class PedestrianModel(ABC):
    """Decides once a control step where the pedestrians of all worlds walk.

    A simulator calls :meth:`reset` when worlds begin an episode, after it has placed each
    pedestrian at the start of its scripted route, and :meth:`targets` before each step. Between
    two decisions a pedestrian walks a straight line at constant speed, and faces along it.

    Attributes:
        is_reactive: Whether pedestrians may depart from the routes of their scenario. A simulator
            does not call a model that is not reactive, and only then is the future known.
    """

    is_reactive: bool = True

    def reset(self, worlds: Tensor, scenarios: ScenarioBatch) -> None:  # noqa: B027, may be empty
        """Begin episodes.

        Args:
            worlds: [M] int64, the worlds that begin one.
            scenarios: M scenarios; pedestrians present come first, in the order of
                :attr:`SimState.pedestrians`.
        """

    @abstractmethod
    def targets(self, state: SimState, duration_s: float) -> Tensor:
        """Return where each pedestrian's center will be at the end of the step.

        Args:
            state: Of all worlds, at the start of the step. A world in contact is not moved.
            duration_s: Of the step, s.

        Returns:
            [N, K, 2] m, world. NaN lets a pedestrian follow its scripted route: for the whole
            episode, since that is a function of time alone.
        """

    def state_dict(self) -> dict[str, Tensor]:
        """Return all that :meth:`load_state_dict` needs to continue bit for bit."""
        return {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:  # noqa: B027, may be empty
        """Continue from what :meth:`state_dict` returned."""


class ScriptedRoutes(PedestrianModel):
    """Pedestrians walk their scenario's routes to and fro and never react.

    Reference:
        Paper Sec. IV-F: pedestrians that do not give way.
    """

    is_reactive = False

    def targets(self, state: SimState, duration_s: float) -> Tensor:
        """Return NaN for each pedestrian: its route says where it is."""
        return torch.full_like(state.pedestrians[..., :2], torch.nan)


def step_legs(boxes: Tensor, targets: Tensor) -> Tensor:
    """Return the straight line that each pedestrian walks during a step.

    Args:
        boxes: [N, K, 5] float64 (cx, cy, hx, hy, yaw) at the step's start, world; NaN rows absent.
        targets: [N, K, 2] m, centers at the step's end; NaN rows follow their scripted route.

    Returns:
        [N, K, 5] float64 (x, y at the start, x, y at the end, yaw); NaN rows walk no such line.

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
    """Return where pedestrians are at several times within a step.

    Args:
        legs: [N, K, 5], see :func:`step_legs`.
        boxes: [N, K, 5] at the step's start.
        scripted: [N, S, K, 5], where those without a leg are.
        shares: [S] of the step that have passed, in [0, 1].

    Returns:
        [N, S, K, 5] float64 boxes, world.
    """
    share = shares[:, None, None]
    center = legs[:, None, :, :2] + share * (legs[:, None, :, 2:4] - legs[:, None, :, :2])
    size = boxes[:, None, :, 2:4].expand_as(center)
    yaw = legs[:, None, :, 4:].expand(*center.shape[:-1], 1)
    walked = torch.cat((center, size, yaw), dim=-1)
    return torch.where(legs[:, None, :, :1].isnan(), scripted, walked)
