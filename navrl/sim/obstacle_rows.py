"""Obstacles and pedestrians of scenarios as arguments of the kernels."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.worlds import ScenarioBatch, track_gaits

CELL_M = 1.0  # m, smallest cell of the grid of walls
MIN_WALLS = 64  # worlds with fewer walls have no grid
MAX_CELLS = 4096  # of a world; cells of larger worlds are larger


def visibility(scenarios: ScenarioBatch, lidar_height: float, height: float) -> Tensor:
    """Return whether the lidar sees, and the hull can touch, each obstacle, ``[M, W, 2]``.

    Args:
        scenarios: M scenarios.
        lidar_height: Height of the scan plane, m.
        height: Height of the robot, m.
    """
    bottom, top = scenarios.box_heights.unbind(-1)
    is_seen = (bottom <= lidar_height) & (lidar_height < top)
    return torch.stack((is_seen, (bottom < height) & (top > 0.0)), dim=-1)


def packed_walls(scenarios: ScenarioBatch, lidar_height: float, height: float) -> Tensor:
    """Return the walls as rows [M, W, 8] in the layout of :mod:`navrl.ops.kernels.worlds`."""
    boxes = scenarios.boxes.double()
    yaw = boxes[..., 4:5]
    direction = torch.cat((torch.cos(yaw), torch.sin(yaw)), dim=-1)
    direction = direction.masked_fill(scenarios.box_is_disc[..., None], 0.0)
    flags = visibility(scenarios, lidar_height, height)
    return torch.cat((boxes[..., :4], direction, flags.double()), dim=-1)


def packed_walk(scenarios: ScenarioBatch) -> Tensor:
    """Return the walks as rows [M, K, 7] in the layout of :mod:`navrl.ops.kernels.worlds`.

    Rows of absent pedestrians are NaN.
    """
    columns = (
        scenarios.ped_speed[..., None],
        scenarios.ped_offset[..., None],
        scenarios.ped_half,
        scenarios.ped_body[..., None].double(),
        scenarios.ped_leg_radius[..., None],
        scenarios.ped_tracked[..., None].double(),
    )
    walk = torch.cat(columns, dim=-1)
    return walk.masked_fill(~scenarios.ped_present[..., None], torch.nan)


def sorted_walls(scenarios: ScenarioBatch, walls: Tensor) -> dict[str, Tensor]:
    """Return walls sorted by the cells of a grid, see :mod:`navrl.ops.kernels.cells`.

    Args:
        scenarios: M scenarios.
        walls: [M, W, 8] of :func:`packed_walls`.

    Returns:
        ``walls``, their former indices ``wall_order [M, W]``, ``cell_start`` and ``cell_info``.
    """
    count, width = scenarios.num_boxes, walls.shape[1]
    order = torch.arange(width, device=walls.device).expand(len(walls), -1)
    if width < MIN_WALLS:
        start, info = count.new_zeros(len(walls), 2), walls.new_zeros(len(walls), 5)
        return {"walls": walls, "wall_order": order, "cell_start": start, "cell_info": info}
    cell, info = _cells(walls, order < count[:, None])
    info[:, 3:] = info[:, 3:].masked_fill((count < MIN_WALLS)[:, None], 0.0)
    ordered, order = torch.sort(cell, dim=1, stable=True)
    cells = torch.arange(-1, int(info[:, 3:].prod(-1).amax()) + 1, device=walls.device)
    start = torch.searchsorted(ordered, cells.expand(len(walls), -1).contiguous())
    sorted_rows = walls.gather(1, order[..., None].expand_as(walls))
    return {"walls": sorted_rows, "wall_order": order, "cell_start": start, "cell_info": info}


def _cells(walls: Tensor, is_wall: Tensor) -> tuple[Tensor, Tensor]:
    """Return the cell [M, W] of each wall, -1 if it does not fit, and the grids [M, 5]."""
    center, diagonal = walls[..., :2], 2.0 * walls[..., 2:4].norm(dim=-1)
    low = center.masked_fill(~is_wall[..., None], torch.inf).amin(1).nan_to_num(posinf=0.0)
    high = center.masked_fill(~is_wall[..., None], -torch.inf).amax(1)
    extent = (high - low).clamp_min(1.0)
    size = torch.sqrt(extent.prod(-1) / (0.5 * MAX_CELLS)).clamp_min(CELL_M)
    size = torch.maximum(size, extent.amax(-1) / (0.5 * MAX_CELLS))
    shape = (extent / size[:, None]).floor() + 1.0
    column, line = ((center - low[:, None]) / size[:, None, None]).floor().unbind(-1)
    cell = (column * shape[:, 1:] + line).long()
    cell = cell.masked_fill(diagonal > size[:, None], -1)
    last = torch.iinfo(torch.int64).max
    return cell.masked_fill(~is_wall, last), torch.cat((low, size[:, None], shape), dim=-1)


def gaits_of(scenarios: ScenarioBatch) -> Tensor:
    """Return [M, K, G, 3], the gaits of :mod:`navrl.ops.kernels.worlds`; G = 0 without tracks."""
    if not bool(scenarios.ped_tracked.any()):
        return scenarios.route.new_zeros(*scenarios.route.shape[:2], 0, 3)
    return track_gaits(scenarios.route, scenarios.route_arc)
