"""Obstacles and pedestrians of scenarios as arguments of the kernels."""

from __future__ import annotations

import torch
from torch import Tensor

from navrl.worlds import ScenarioBatch, track_gaits

CELL_M = 1.0  # m, smallest cell of the grid of walls
MIN_WALLS = 64  # worlds with fewer walls have no grid
MAX_CELLS = 4096  # of a world; cells of larger worlds are larger


def visibility(scenarios: ScenarioBatch, lidar_height: float, height: float) -> Tensor:
    """Return which obstacles the lidar sees and the hull can touch, ``[M, W, 2]`` bool.

    Args:
        scenarios: M scenarios.
        lidar_height: Height of the scan plane, m.
        height: Height of the robot, m.
    """
    bottom, top = scenarios.box_heights.unbind(-1)
    is_seen = (bottom <= lidar_height) & (lidar_height < top)
    return torch.stack((is_seen, (bottom < height) & (top > 0.0)), dim=-1)


def packed_walls(scenarios: ScenarioBatch, lidar_height: float, height: float) -> Tensor:
    """Return [M, W, 8], the walls of :mod:`navrl.ops.kernels.worlds`."""
    boxes = scenarios.boxes.double()
    yaw = boxes[..., 4:5]
    direction = torch.cat((torch.cos(yaw), torch.sin(yaw)), dim=-1)
    direction = direction.masked_fill(scenarios.box_is_disc[..., None], 0.0)
    flags = visibility(scenarios, lidar_height, height)
    return torch.cat((boxes[..., :4], direction, flags.double()), dim=-1)


def packed_walk(scenarios: ScenarioBatch) -> Tensor:
    """Return [M, K, 7], the walks of :mod:`navrl.ops.kernels.worlds`; NaN rows are absent."""
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


def wall_cells(scenarios: ScenarioBatch) -> dict[str, Tensor]:
    """Return the grids of walls, the arrays of :mod:`navrl.ops.kernels.cells` by name."""
    boxes, count = scenarios.boxes.double(), scenarios.num_boxes
    worlds, width = boxes.shape[:2]
    is_wall = torch.arange(width, device=boxes.device) < count[:, None]
    if width < MIN_WALLS:
        info = boxes.new_zeros(worlds, 5)
        return {"cell_info": info, **_cells_of(torch.zeros_like(count)[:, None], 0, width)}
    center, diagonal = boxes[..., :2], 2.0 * boxes[..., 2:4].norm(dim=-1)
    low = center.masked_fill(~is_wall[..., None], torch.inf).amin(1).nan_to_num(posinf=0.0)
    high = center.masked_fill(~is_wall[..., None], -torch.inf).amax(1)
    extent = (high - low).clamp_min(1.0)
    size = torch.sqrt(extent.prod(-1) / (0.5 * MAX_CELLS)).clamp_min(CELL_M)
    size = torch.maximum(size, extent.amax(-1) / (0.5 * MAX_CELLS))
    shape = (extent / size[:, None]).floor() + 1.0
    shape = shape.masked_fill((count < MIN_WALLS)[:, None], 0.0)
    column, line = ((center - low[:, None]) / size[:, None, None]).floor().unbind(-1)
    cell = (column * shape[:, 1:] + line).long()
    cell = cell.masked_fill(diagonal > size[:, None], -1)  # does not fit
    max_cells = int(shape.prod(-1).amax())
    cell = cell.masked_fill(~is_wall, max_cells)
    info = torch.cat((low, size[:, None], shape), dim=-1)
    return {"cell_info": info, **_cells_of(cell, max_cells, width)}


def _cells_of(cell: Tensor, max_cells: int, width: int) -> dict[str, Tensor]:
    """Return walls sorted by cell, ``cell [M, W]``, and the first entry of each cell."""
    if max_cells == 0:
        walls = cell.new_zeros(len(cell), width)
        return {"cell_walls": walls, "cell_start": cell.new_zeros(len(cell), 2)}
    ordered, walls = torch.sort(cell, dim=1, stable=True)
    cells = torch.arange(-1, max_cells + 1, device=cell.device).expand(len(cell), -1)
    return {"cell_walls": walls, "cell_start": torch.searchsorted(ordered, cells.contiguous())}


def gaits_of(scenarios: ScenarioBatch) -> Tensor:
    """Return [M, K, G, 3], the gaits of :mod:`navrl.ops.kernels.worlds`; G = 0 without tracks."""
    if not bool(scenarios.ped_tracked.any()):
        return scenarios.route.new_zeros(*scenarios.route.shape[:2], 0, 3)
    return track_gaits(scenarios.route, scenarios.route_arc)
