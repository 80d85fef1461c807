"""Inputs of the space-time search: walls, pedestrians per substep and two grid maps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from skimage.graph import MCP_Geometric
from torch import Tensor

from navrl.ops.bodies import BODY_LEGS
from navrl.ops.distance import point_box_distance
from navrl.ops.gait import HALF_STEP_WIDTH_M, MAX_STRIDE
from navrl.worlds import ScenarioBatch, pedestrian_states

_SEARCH_MARGIN_M = 1.5  # m around the path that is searched if no wall bounds it


class SpaceTimeMaps(NamedTuple):
    """Arguments of :func:`navrl.ops.kernels.space_time.plan_kernel`, in its order."""

    start: Tensor
    goal: Tensor
    walls: Tensor
    num_walls: Tensor
    people: Tensor
    origin: Tensor
    clearance: Tensor
    steps_to_go: Tensor


def space_time_maps(
    scenarios: ScenarioBatch, time_s: Tensor, reach: float, cell: float, step_length: float
) -> SpaceTimeMaps:
    """Compute the maps and pedestrian positions that the space-time search reads.

    Args:
        scenarios: ``[S]``.
        time_s: ``[T]`` s, times of the pedestrians' positions.
        reach: Minimum distance of the robot's center to all obstacles, m.
        cell: Size of a grid cell, m.
        step_length: Length of the longest step, m.
    """
    walls = _with_direction(scenarios.boxes.double())
    low, high = _floor(scenarios)
    size = ((high - low).amax(0) / cell).ceil().long()
    clearance = torch.stack(
        [
            _clearance(
                scenarios.boxes[s, : int(scenarios.num_boxes[s])], low[s], high[s], size, cell
            )
            for s in range(len(scenarios))
        ]
    )
    steps_to_go = np.stack(
        [
            _steps_to_go(clearance[s].numpy(), scenarios.goal[s] - low[s], reach, cell, step_length)
            for s in range(len(scenarios))
        ]
    )
    return SpaceTimeMaps(
        scenarios.start.double(),
        scenarios.goal.double(),
        walls,
        scenarios.num_boxes,
        _people(scenarios, time_s),
        low,
        clearance,
        torch.from_numpy(steps_to_go),
    )


def _with_direction(boxes: Tensor) -> Tensor:
    """Replace the yaw of boxes ``[..., 5]`` by its cosine and sine."""
    yaw = boxes[..., 4:]
    return torch.cat([boxes[..., :4], yaw.cos(), yaw.sin()], dim=-1)


def _people(scenarios: ScenarioBatch, time_s: Tensor) -> Tensor:
    """Return ``[S, T, K, 6]`` boxes of the pedestrians; NaN rows for absent ones.

    The box of a pedestrian with legs includes them, wherever they are in their step.
    """
    found = []
    for row in torch.arange(len(scenarios)):
        states = pedestrian_states(scenarios[row.expand(len(time_s))], time_s)
        boxes, leg = states[..., :5].clone(), scenarios.ped_leg_radius[row]
        has_legs = (scenarios.ped_body[row] == BODY_LEGS)[:, None]
        along = MAX_STRIDE * states[..., 6] + leg
        across = (HALF_STEP_WIDTH_M + leg).expand_as(along)
        reach = torch.maximum(boxes[..., 2:4], torch.stack((along, across), dim=-1))
        boxes[..., 2:4] = torch.where(has_legs, reach, boxes[..., 2:4])
        found.append(_with_direction(boxes))
    return torch.stack(found)


def _floor(scenarios: ScenarioBatch) -> tuple[Tensor, Tensor]:
    """Return the corners ``[S, 2]`` of a rectangle around the path and all walls."""
    path = scenarios.path.double()
    low, high = path.amin(1) - _SEARCH_MARGIN_M, path.amax(1) + _SEARCH_MARGIN_M
    extent = scenarios.boxes[..., 2:4].norm(dim=-1, keepdim=True)
    is_wall = torch.arange(extent.shape[1]) < scenarios.num_boxes[:, None]
    below = (scenarios.boxes[..., :2] - extent).masked_fill(~is_wall[..., None], torch.inf)
    above = (scenarios.boxes[..., :2] + extent).masked_fill(~is_wall[..., None], -torch.inf)
    return torch.minimum(low, below.amin(1)), torch.maximum(high, above.amax(1))


def _clearance(boxes: Tensor, low: Tensor, high: Tensor, size: Tensor, cell: float) -> Tensor:
    """Return ``[CX, CY]`` m from each cell's center to the nearest wall; 0 outside the map."""
    x, y = (low[axis] + (torch.arange(int(size[axis])) + 0.5) * cell for axis in range(2))
    centers = torch.stack(torch.meshgrid(x, y, indexing="ij"), dim=-1)
    distance = point_box_distance(centers, boxes.double().expand(*centers.shape[:2], -1, -1))
    nearest = distance.amin(-1) if len(boxes) else torch.full(centers.shape[:2], torch.inf).double()
    return nearest.masked_fill((centers > high).any(-1), 0.0)


def _steps_to_go(
    clearance: np.ndarray, goal: Tensor, reach: float, cell: float, step_length: float
) -> np.ndarray:
    """Return ``[CX, CY]`` steps to the goal around the walls; infinite if unreachable."""
    costs = np.where(clearance + 0.71 * cell > reach, 1.0, -1.0)
    index = tuple(int(value) for value in (goal / cell).floor())
    costs[index] = 1.0
    distance, _ = MCP_Geometric(costs).find_costs([index])
    return distance * (cell / step_length)
