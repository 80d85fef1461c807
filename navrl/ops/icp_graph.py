"""Iterations of ICP as one loop of an exported graph, with few operations in each.

An inference engine spends more time on starting an operation than on the numbers of one scan. So
motions are matrices by which rows (x, y, 1) are multiplied, and sums over pairs are one product.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch._higher_order_ops.while_loop import while_loop

from navrl.ops.exporting import first_minimum, solve_motion, take_rows
from navrl.ops.icp_options import DAMPING, IcpOptions
from navrl.ops.icp_pairs import distance_factors, line_equations, pair_weights
from navrl.ops.lines import ScanLines

_TINY = 1e-100  # cosine of no rotation where pairs determine none; too small to change another
# Products of the sums over pairs K[i, j] of source (x, y, 1)[i] and target (x, y, 1)[j], row by row
# in 9 columns: six left and six right factors, sums of source and target, and number of pairs.
_LEFT = ["11", "11", "x1", "y1", "x1", "y1"]
_RIGHT = ["xy-yx", "xx+yy", "1y", "1x", "1x", "1y"]
_SUMS = ["x1", "y1", "1x", "1y", "11"]
_NAMES = ["xx", "xy", "x1", "yx", "yy", "y1", "1x", "1y", "11"]
# (cosine, sine) of the rotation, times a positive number, from the six products.
_TURN = [[0, 1], [1, 0], [0, -1], [0, 1], [-1, 0], [-1, 0]]
_ROTATION = [[1, 0, 0, 1], [0, 1, -1, 0]]  # rows of the rotation matrix from (cosine, sine)
_MATRIX = [  # rows of the matrix of a motion from (cosine, sine, x, y)
    [1, 0, 0, 0, 1, 0, 0, 0, 0],
    [0, 1, 0, -1, 0, 0, 0, 0, 0],
    [0, 0, 0, 0, 0, 0, 1, 0, 0],
    [0, 0, 0, 0, 0, 0, 0, 1, 0],
]
_CORNER = [0, 0, 0, 0, 0, 0, 0, 0, 1]  # the matrix of any motion has a 1 there


class Tables(NamedTuple):
    """Constant factors of :func:`rigid_step` and :func:`step_matrix`, made before the loop."""

    sums: Tensor
    """``[9, 17]`` combinations of the sums over pairs."""
    turn: Tensor
    """``[6, 2]`` signs of their products in cosine and sine."""
    tiny: Tensor
    """``[2]`` cosine and sine where pairs determine no rotation."""
    rotation: Tensor
    """``[2, 4]`` entries of a rotation matrix."""
    matrix: Tensor
    """``[4, 9]`` entries of the matrix of a motion."""
    corner: Tensor
    """``[9]`` its last entry."""

    @classmethod
    def like(cls, values: Tensor) -> Tables:
        """Return the factors in the type and on the device of ``values``."""
        combined = _columns(_LEFT + _RIGHT + _SUMS)
        entries = (combined, _TURN, [_TINY, 0.0], _ROTATION, _MATRIX, _CORNER)
        kind = {"dtype": values.dtype, "device": values.device}
        return cls(*(torch.tensor(each, **kind) for each in entries))


def iterate(
    transform: Tensor, scans: Sequence[Tensor], lines: ScanLines | None, options: IcpOptions
) -> tuple[Tensor, Tensor, Tensor]:
    """Improve the motions between scans until each converges, fails or hits the limit.

    Args:
        transform: ``[S, 3]`` (m, m, rad) T_target_source to start from, float64.
        scans: Points ``[S, N, 2]`` m and returns ``[S, N]`` of the source, then of the target.
        lines: Lines of the target for steps by distances to them; None for distances to points.
        options: Settings of the alignment.

    Returns:
        ``[S, 3]`` transform, ``[S]`` bool whether it is unfinished, and ``[S]`` int64 matched pairs
        of the last iteration.

    Example:
        >>> class Aligned(torch.nn.Module):
        ...     def forward(self, start, source, target):
        ...         every = torch.ones_like(source[..., 0], dtype=torch.bool)
        ...         return iterate(start, (source, every, target, every), None, IcpOptions())
        >>> angle = torch.linspace(0.0, 6.0, 40, dtype=torch.float64)
        >>> source = torch.stack([2.0 * angle.cos(), angle.sin()], dim=-1)[None]
        >>> scans = (torch.zeros(1, 3, dtype=torch.float64), source, source + 0.05)
        >>> exported = torch.export.export(Aligned(), scans, strict=False).module()
        >>> exported(*scans)[0].round(decimals=2)
        tensor([[0.0500, 0.0500, 0.0000]], dtype=torch.float64)
    """
    source, source_returns, target, target_returns = scans
    points, table = _with_ones(source), _with_ones(target)
    if lines is not None:
        table = torch.cat([table, lines.normal, lines.is_line.unsqueeze(-1).to(table.dtype)], -1)
    factors = distance_factors(target, target_returns)
    tables = Tables.like(source)
    # A number would be written in float32, as 1.
    least_cosine = source.new_tensor(math.cos(options.rotation_tolerance))
    usable = (source_returns & target_returns.any(-1, keepdim=True)).unsqueeze(-1)

    def is_unfinished(count: Tensor, running: Tensor, *_: Tensor) -> Tensor:
        return (count < options.max_iterations) & running.any()

    def improve(
        count: Tensor, running: Tensor, motion: Tensor, pairs: Tensor
    ) -> tuple[Tensor, ...]:
        moved = points @ motion
        rows = take_rows(table, first_minimum(moved @ factors))
        closest = rows if lines is None else rows[..., :3]
        offset = moved - closest
        distance = (offset * offset).sum(-1, keepdim=True)
        matched = usable & (distance <= options.gate**2)
        if lines is None:
            step, number = rigid_step(moved, closest, matched.to(moved.dtype), tables)
        else:
            step, number = _line_step(moved, rows, matched, options.robust_scale)
        small = step[..., :1] > least_cosine
        shift = torch.linalg.vector_norm(step[..., 2:], dim=-1, keepdim=True)
        small &= shift < options.translation_tolerance
        moves = running & (number >= options.min_pairs)
        motion = torch.where(moves, motion @ step_matrix(step, tables), motion)
        return count + 1, moves & ~small, motion, torch.where(running, number, pairs)

    yaw = transform[:, None, 2:]
    start = torch.cat([yaw.cos(), yaw.sin(), transform[:, None, :2]], dim=-1)
    start = step_matrix(start, tables)
    pairs = torch.zeros_like(yaw)
    running = torch.ones_like(yaw, dtype=torch.bool)
    count = torch.zeros((), dtype=torch.int64, device=yaw.device)
    _, running, motion, pairs = while_loop(is_unfinished, improve, (count, running, start, pairs))
    yaw = torch.atan2(motion[:, 0, 1:2], motion[:, 0, :1])
    transform = torch.cat([motion[:, 2, :2], yaw], dim=-1)
    return transform, running.flatten(), pairs.flatten().to(torch.int64)


def rigid_step(
    source: Tensor, target: Tensor, weight: Tensor, tables: Tables
) -> tuple[Tensor, Tensor]:
    """Return the motion of :func:`navrl.ops.rigid_fit.fit_rigid` from one product.

    Moments are subtracted instead of means, whose rounding requires float64.

    Args:
        source: ``[S, N, 3]`` rows (x, y, 1), m.
        target: ``[S, N, 3]`` rows matched with ``source`` by index.
        weight: ``[S, N, 1]``, 1 for each pair and 0 for others.
        tables: Of the type of the points.

    Returns:
        ``[S, 1, 4]`` cosine and sine of the rotation, and translation, m; ``[S, 1, 1]`` sum of the
        weights.

    Example:
        >>> source = torch.tensor([[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]])
        >>> moved = source + torch.tensor([0.0, 2.0, 0.0])
        >>> rigid_step(source, moved, torch.ones(1, 2, 1), Tables.like(source))[0].abs()
        tensor([[[1., 0., 0., 2.]]])
    """
    sums = ((source * weight).mT @ target).flatten(-2).unsqueeze(-2)
    parts = sums @ tables.sums
    left, right, totals, number = parts.split([6, 6, 4, 1], dim=-1)
    turn = (left * right) @ tables.turn + tables.tiny
    turn = turn / torch.linalg.vector_norm(turn, dim=-1, keepdim=True)
    source_mean, target_mean = (totals / number.clamp(min=1.0)).split(2, dim=-1)
    rows = turn @ tables.rotation
    translation = target_mean - source_mean @ rows.unflatten(-1, (2, 2)).squeeze(-3)
    return torch.cat([turn, translation], dim=-1), number


def step_matrix(step: Tensor, tables: Tables) -> Tensor:
    """Return the matrix ``[S, 3, 3]`` by which rows (x, y, 1) are multiplied to move them.

    Args:
        step: ``[S, 1, 4]`` cosine and sine of the rotation, and translation, m.
        tables: Of the type of the step.

    Example:
        >>> quarter_turn = torch.tensor([[[0.0, 1.0, 2.0, 0.0]]])
        >>> torch.tensor([1.0, 0.0, 1.0]) @ step_matrix(quarter_turn, Tables.like(quarter_turn))[0]
        tensor([2., 1., 1.])
    """
    entries = step @ tables.matrix + tables.corner
    return entries.unflatten(-1, (3, 3)).squeeze(-3)


def _line_step(
    moved: Tensor, rows: Tensor, matched: Tensor, robust_scale: float | None
) -> tuple[Tensor, Tensor]:
    """Return the step ``[S, 1, 4]`` for distances to the matched lines, and the pairs."""
    points, closest, pairs = moved[..., :2], rows[..., :2], matched.squeeze(-1)
    lines = ScanLines(rows[..., 3:5], rows[..., 5] > 0.5)
    weight, _ = pair_weights(points, closest, pairs, lines, robust_scale)
    normal_matrix, vector = line_equations(points, closest, weight, lines)
    damping = DAMPING * torch.eye(3, dtype=vector.dtype, device=vector.device)
    motion = -solve_motion(normal_matrix + damping, vector).unsqueeze(-2)
    yaw = motion[..., 2:]
    step = torch.cat([yaw.cos(), yaw.sin(), motion[..., :2]], dim=-1)
    return step, matched.to(moved.dtype).sum(-2, keepdim=True)


def _with_ones(points: Tensor) -> Tensor:
    return torch.cat([points, torch.ones_like(points[..., :1])], dim=-1)


def _columns(names: Sequence[str]) -> list[list[float]]:
    """Return the matrix ``[9, len(names)]`` that forms named combinations of the sums."""
    signs = {"-": -1.0, "+": 1.0}
    columns = []
    for name in names:
        second = {name[3:]: signs[name[2]]} if len(name) > 2 else {}
        chosen = {name[:2]: 1.0} | second
        columns.append([chosen.get(entry, 0.0) for entry in _NAMES])
    return [list(row) for row in zip(*columns, strict=True)]
