"""Pedestrian models: motion of the pedestrians during a control step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from navrl.ops.gait import step_length

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


def step_moves(states: Tensor, targets: Tensor, duration_s: float) -> Tensor:
    """Return the line segment on which each pedestrian walks during a step, and its gait.

    Args:
        states: [N, K, 7] float64 states of :func:`navrl.worlds.pedestrian_states` at the start of
            the step; NaN rows are absent.
        targets: [N, K, 2] m, centers at the end of the step; NaN rows follow their scripted route.
        duration_s: Duration of the step, s.

    Returns:
        [N, K, 8] float64 (x, y at the start, x, y at the end, yaw, phase at the start and at the
        end, length of a step); NaN rows have no segment.

    Raises:
        ValueError: If the shape of ``targets`` is not ``[N, K, 2]`` or a value is infinite.
    """
    if targets.shape != (*states.shape[:2], 2) or bool(targets.isinf().any()):
        raise ValueError(
            f"targets: must be {[*states.shape[:2], 2]} with NaN or finite numbers, "
            f"got {list(targets.shape)}"
        )
    start, end = states[..., :2], targets.to(states)
    x, y = (end - start).unbind(-1)
    walked = torch.sqrt(x * x + y * y)
    is_still = walked < _SMALLEST_STEP
    yaw = torch.where(is_still, states[..., 4], torch.atan2(y, x))
    length = torch.where(is_still, states[..., 6], step_length(walked / duration_s))
    phase = states[..., 5]
    phase_after = torch.where(is_still, phase, phase + walked / length)
    gait = torch.stack((yaw, phase, phase_after, length), dim=-1)
    moves = torch.cat((start, end, gait), dim=-1)
    return moves.masked_fill(~torch.isfinite(moves).all(-1, keepdim=True), torch.nan)


def states_along(moves: Tensor, states: Tensor, scripted: Tensor, shares: Tensor) -> Tensor:
    """Return the states of pedestrians at several times within a step.

    Args:
        moves: [N, K, 8], see :func:`step_moves`.
        states: [N, K, 7], states at the start of the step.
        scripted: [N, S, K, 7], states of pedestrians without a segment.
        shares: [S], elapsed fractions of the step, in [0, 1].

    Returns:
        [N, S, K, 7] float64 states, world.
    """
    share, moves = shares[:, None, None], moves[:, None]
    center = moves[..., :2] + share * (moves[..., 2:4] - moves[..., :2])
    phase = moves[..., 5:6] + share * (moves[..., 6:7] - moves[..., 5:6])
    size, yaw, length = (
        part.expand(*center.shape[:-1], -1)
        for part in (states[:, None, :, 2:4], moves[..., 4:5], moves[..., 7:])
    )
    walked = torch.cat((center, size, yaw, phase, length), dim=-1)
    return torch.where(moves[..., :1].isnan(), scripted, walked)
