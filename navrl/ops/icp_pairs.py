"""Pairs of a scan's points with the nearest returns of another scan, for ICP."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from navrl.ops.exporting import first_minimum, is_exporting
from navrl.ops.icp_options import SLIDE_WEIGHT
from navrl.ops.lines import ScanLines


def nearest_returns(
    points: Tensor, target: Tensor, target_returns: Tensor
) -> tuple[Tensor, Tensor]:
    """Return squared distance and index of the target return nearest to each point.

    Args:
        points: ``[S, N, 2]`` m.
        target: ``[S, M, 2]`` m, in the same frame.
        target_returns: ``[S, M]`` bool.

    Returns:
        ``[S, N]`` squared distance, m^2, infinite without target returns, and ``[S, N]`` index.

    Example:
        >>> points, target = torch.tensor([[[1.0, 0.0]]]), torch.tensor([[[1.0, 0.5], [3.0, 0.0]]])
        >>> squared, index = nearest_returns(points, target, torch.tensor([[True, True]]))
        >>> squared, index
        (tensor([[0.2500]]), tensor([[0]]))
    """
    if is_exporting():
        return nearest_by_product(points, target, target_returns)
    target = torch.where(target_returns.unsqueeze(-1), target, math.inf)
    x = points[:, :, None, 0] - target[:, None, :, 0]
    y = points[:, :, None, 1] - target[:, None, :, 1]
    return x.square_().addcmul_(y, y).min(dim=-1)


def nearest_by_product(
    points: Tensor, target: Tensor, target_returns: Tensor
) -> tuple[Tensor, Tensor]:
    """Return :func:`nearest_returns` by a matrix product, which an inference engine is fast at.

    The point q nearest to p has the least ``q^2 - 2 p q``, whose rounding requires float64.

    Example:
        >>> points, target = torch.tensor([[[1.0, 0.0]]]), torch.tensor([[[1.0, 0.5], [3.0, 0.0]]])
        >>> nearest_by_product(points, target, torch.tensor([[True, True]]))[1]
        tensor([[0]])
    """
    factors = distance_factors(target, target_returns)
    ones = target.new_ones(target.shape[0], points.shape[1], 1)
    index = first_minimum(torch.cat([points, ones], dim=-1) @ factors)
    squared = (points - take(target, index)).square().sum(-1)
    return torch.where(target_returns.any(-1, keepdim=True), squared, math.inf), index


def distance_factors(target: Tensor, target_returns: Tensor) -> Tensor:
    """Return the factors ``[S, 3, M]`` of rows (x, y, 1) in squared distances to the target.

    The product lacks the row's own square, which does not change which point is nearest.

    Args:
        target: ``[S, M, 2]`` m.
        target_returns: ``[S, M]`` bool; the distance of other points is infinite.

    Example:
        >>> is_return = torch.tensor([[True]])
        >>> target = torch.tensor([[[1.0, 0.5]]])
        >>> torch.tensor([1.0, 0.0, 1.0]) @ distance_factors(target, is_return)
        tensor([[-0.7500]])
    """
    squares = torch.where(target_returns, target.square().sum(-1), math.inf).unsqueeze(-2)
    return torch.cat([-2.0 * target.transpose(-1, -2), squares], dim=-2)


def pair_weights(
    points: Tensor,
    closest: Tensor,
    matched: Tensor,
    lines: ScanLines,
    robust_scale: float | None,
) -> tuple[Tensor, Tensor]:
    """Return robust weight and residual, m, of each pair, ``[S, N]`` each.

    The residual is the distance to the line through the matched point, or to that point if no line
    passes through it.

    Args:
        points: ``[S, N, 2]`` m.
        closest: ``[S, N, 2]`` m, matched target point of each point, in the same frame.
        matched: ``[S, N]`` bool; the weight of other pairs is 0.
        lines: Line through each matched target point, ``[S, N]``.
        robust_scale: Residual, m, at which the weight is 1/4; None for equal weights.

    Example:
        >>> from navrl.ops.lines import fit_lines
        >>> closest = torch.stack([torch.linspace(-1.0, 1.0, 20), torch.ones(20)], dim=-1)[None]
        >>> every = torch.ones(1, 20, dtype=torch.bool)
        >>> lines = fit_lines(closest, every)
        >>> weight, residual = pair_weights(closest + 0.1, closest, every, lines, 0.1)
        >>> weight[0, 10], residual[0, 10]  # the shift along the wall does not count
        (tensor(0.2500), tensor(0.1000))
    """
    offset = points - closest
    across = (offset * lines.normal).sum(-1)
    residual = torch.where(lines.is_line, across.abs(), torch.linalg.vector_norm(offset, dim=-1))
    weight = matched.to(points.dtype)
    if robust_scale is not None:
        weight = weight / (1.0 + (residual / robust_scale).square()).square()
    return weight, residual


def line_equations(
    points: Tensor,
    closest: Tensor,
    weight: Tensor,
    lines: ScanLines,
    slide_weight: float = SLIDE_WEIGHT,
) -> tuple[Tensor, Tensor]:
    """Return matrix ``[S, 3, 3]`` and right side ``[S, 3]`` of the normal equations.

    A pair without a line counts with its point-to-point distance. A pair with a line counts with
    its distance across the line and, weighted by ``slide_weight``, its offset along it.

    Args:
        points: ``[S, N, 2]`` m.
        closest: ``[S, N, 2]`` m, matched target point of each point, in the same frame.
        weight: ``[S, N]`` weight of each pair.
        lines: Line through each matched target point, ``[S, N]``.
        slide_weight: Weight of the residual along a line, relative to that across it.

    Example:
        >>> from navrl.ops.lines import fit_lines
        >>> wall = torch.stack([torch.linspace(-1.0, 1.0, 20), torch.ones(20)], dim=-1)[None]
        >>> lines = fit_lines(wall, torch.ones(1, 20, dtype=torch.bool))
        >>> matrix, _ = line_equations(wall, wall, torch.ones(1, 20), lines, slide_weight=0.0)
        >>> matrix[0].diagonal()[:2].round().abs()  # a wall along x determines y
        tensor([ 0., 20.])
    """
    offset = points - closest
    tangent = torch.stack([lines.normal[..., 1], -lines.normal[..., 0]], dim=-1)
    along = weight * torch.where(lines.is_line, slide_weight, 1.0)
    rows, values, weights = [], [], []
    for direction, w in ((lines.normal, weight), (tangent, along)):
        lever = points[..., 0] * direction[..., 1] - points[..., 1] * direction[..., 0]
        rows.append(torch.cat([direction, lever.unsqueeze(-1)], dim=-1))
        values.append((offset * direction).sum(-1))
        weights.append(w)
    jacobian, value = torch.cat(rows, dim=-2), torch.cat(values, dim=-1)
    weighted = jacobian * torch.cat(weights, dim=-1).unsqueeze(-1)
    return weighted.mT @ jacobian, (weighted * value.unsqueeze(-1)).sum(-2)


def take(values: Tensor, index: Tensor) -> Tensor:
    """Gather ``values [S, M, ...]`` at ``index [S, N]``.

    Example:
        >>> take(torch.tensor([[5.0, 6.0, 7.0]]), torch.tensor([[2, 0]]))
        tensor([[7., 5.]])
    """
    if is_exporting():
        trailing = values.shape[2:]
        return values.gather(
            1, index.reshape(*index.shape, *[1] * len(trailing)).expand(-1, -1, *trailing)
        )
    row = torch.arange(len(index), device=index.device).unsqueeze(-1)
    return values[row, index]
