"""Iterative closest point (ICP): rigid motion between two lidar scans."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from navrl.ops import icp_graph, se2
from navrl.ops.backend import Backend, as_real, check_same_device, is_compiled
from navrl.ops.exporting import is_exporting, kernel_precision
from navrl.ops.icp_options import DAMPING, PAPER, IcpOptions
from navrl.ops.icp_pairs import line_equations, nearest_returns, pair_weights, take
from navrl.ops.lines import ScanLines, fit_lines
from navrl.ops.returns import finite_returns
from navrl.ops.rigid_fit import fit_rigid
from navrl.ops.rotation_search import rotation_search

PAIRS_PER_BLOCK = 2**22  # memory bound of the nearest-neighbor search, elements


class Alignment(NamedTuple):
    """Result of :func:`align`."""

    transform: Tensor
    """``[*B, 3]`` (m, m, rad) T_target_source; identity where the alignment failed."""
    converged: Tensor
    """``[*B]`` bool, whether the last step was below the tolerances with enough matches."""
    inliers: Tensor
    """``[*B]`` int64, matched pairs of the last iteration."""
    rmse: Tensor
    """``[*B]`` m, root mean square distance of these pairs before the last step; 0 if none."""
    iterations: Tensor
    """``[*B]`` int64, iterations of all stages."""


def align(
    source_points: Tensor,
    source_returns: Tensor,
    target_points: Tensor,
    target_returns: Tensor,
    options: IcpOptions = PAPER,
    backend: Backend = "auto",
    seen: Tensor | None = None,
) -> Alignment:
    """Estimate the rigid motion that aligns a source scan with a target scan.

    Each sample of the batch iterates independently and is frozen once it converges, so its result
    does not depend on the rest of the batch except for rounding. Points without a return are
    ignored: the circle of maximum ranges does not move with the robot and would bias the estimate
    towards no motion.

    Args:
        source_points: ``[*B, N, 2]`` m, e.g. scan t-1 in its own frame.
        source_returns: ``[*B, N]`` bool, which points are real returns; non-finite points are
            ignored.
        target_points: ``[*B, M, 2]`` m, e.g. scan t in its own frame.
        target_returns: ``[*B, M]`` bool.
        options: Settings of the alignment.
        backend: See :mod:`navrl.ops.backend`. The kernel computes in float64 and is fastest if the
            target is ordered by bearing and has as many points as the source.
        seen: ``[*B, N]`` bool, bearings covered by the scanner, for the rotation search; None for a
            full circle.

    Returns:
        The alignment; ``se2.transform_points(result.transform, source_points)`` is the source scan
        in the target's frame.

    Raises:
        ValueError: If a shape does not match; the message names it.

    Example:
        >>> source = torch.tensor([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]).repeat(4, 1)
        >>> is_return = torch.ones(12, dtype=torch.bool)
        >>> target = source + torch.tensor([0.1, 0.0])
        >>> align(source, is_return, target, is_return).transform.round(decimals=3).abs()
        tensor([0.1000, 0.0000, 0.0000])

    Reference:
        Paper Sec. IV-A specifies least-squares ICP without settings; see :class:`IcpOptions`. The
        rotation search and the point-to-line stage are additions.
    """
    _check_scans(source_points, source_returns, target_points, target_returns, options)
    if seen is not None and (seen.shape != source_returns.shape or seen.dtype != torch.bool):
        shapes = f"{tuple(source_returns.shape)}, got {seen.dtype} of shape {tuple(seen.shape)}"
        raise ValueError(f"seen: must be bool of shape {shapes}")
    source_points, target_points = as_real(source_points), as_real(target_points)
    scans = (source_points, source_returns, target_points, target_returns)
    if is_compiled(backend, *scans):
        return _align_compiled(scans, seen, options)
    dtype = source_points.dtype
    source_points, target_points = kernel_precision(source_points), kernel_precision(target_points)
    source_returns = finite_returns(source_points, source_returns)
    target_returns = finite_returns(target_points, target_returns)
    *batch, num_source, _ = source_points.shape
    num_target = target_points.shape[-2]
    scans = (
        torch.where(source_returns.unsqueeze(-1), source_points, 0.0).reshape(-1, num_source, 2),
        source_returns.reshape(-1, num_source),
        torch.where(target_returns.unsqueeze(-1), target_points, 0.0).reshape(-1, num_target, 2),
        target_returns.reshape(-1, num_target),
    )
    scans += () if seen is None else (seen.reshape(-1, num_source),)
    size = max(1, PAIRS_PER_BLOCK // (num_source * num_target))
    split = [scans] if is_exporting() else zip(*(scan.split(size) for scan in scans), strict=True)
    blocks = [_align(options, *block) for block in split]
    parts = [torch.cat(part) for part in zip(*blocks, strict=True)]
    parts = [part.to(dtype) if part.is_floating_point() else part for part in parts]
    return Alignment(*(part.reshape((*batch, *part.shape[1:])) for part in parts))


def _align_compiled(
    scans: tuple[Tensor, ...], seen: Tensor | None, options: IcpOptions
) -> Alignment:
    from navrl.ops.kernels.icp import align_scans

    batch = scans[0].shape[:-2]
    source, source_returns, target, target_returns = (
        scan.reshape(batch.numel(), *scan.shape[len(batch) :]) for scan in scans
    )
    seen = seen if seen is None else seen.reshape(batch.numel(), -1)
    limits = (
        float(options.gate),
        math.inf if options.robust_scale is None else float(options.robust_scale),
        float(options.rotation_tolerance),
        float(options.translation_tolerance),
        float(options.search_range),
    )
    results = align_scans(
        *(source, source_returns, target, target_returns, seen),
        *(options.initialization, options.metric, limits),
        *(options.max_iterations, options.min_pairs),
    )
    return Alignment(*(result.reshape(batch + result.shape[1:]) for result in results))


def _align(
    options: IcpOptions,
    source: Tensor,
    source_returns: Tensor,
    target: Tensor,
    target_returns: Tensor,
    seen: Tensor | None = None,
) -> Alignment:
    """Align one block ``[S, N, 2]`` of sanitized scans through all stages."""
    transform = source.new_zeros(source.shape[0], 3)
    if options.initialization == "rotation_search":
        transform[:, 2] = rotation_search(
            source, source_returns, target, target_returns, options.search_range, seen
        )
    count = torch.zeros_like(source_returns[:, 0], dtype=torch.int64)
    state = Alignment(transform, count.bool(), count.clone(), transform[:, 0].clone(), count)
    scans = (source, source_returns, target, target_returns)
    iterate = _iterate_in_graph if is_exporting() else _iterate
    state = iterate(state, scans, None, options)
    if options.metric == "point_to_line":
        state = iterate(state, scans, fit_lines(target, target_returns), options)
    failed = state.inliers < options.min_pairs
    return state._replace(transform=state.transform.masked_fill(failed.unsqueeze(-1), 0.0))


def _iterate(
    state: Alignment, scans: tuple[Tensor, ...], lines: ScanLines | None, options: IcpOptions
) -> Alignment:
    """Iterate every sample of ``state`` in place until it converges, fails or hits the limit."""
    running = torch.arange(len(state.transform), device=state.transform.device)
    for _ in range(options.max_iterations):
        if running.numel() == 0:
            break
        own_lines = None if lines is None else ScanLines(*(part[running] for part in lines))
        own_scans = tuple(scan[running] for scan in scans)
        found, small = _improve(state.transform[running], own_scans, own_lines, options)
        for values, own in zip(state, found, strict=True):
            if values is not state.iterations:
                values[running] = own
        state.iterations[running] += 1
        running = running[~small]
    return state


def _iterate_in_graph(
    state: Alignment, scans: tuple[Tensor, ...], lines: ScanLines | None, options: IcpOptions
) -> Alignment:
    """Return the result of :func:`_iterate` by :func:`navrl.ops.icp_graph.iterate`.

    Only what the pipeline reads is carried: the residual is NaN and the iterations are -1.
    """
    transform, unfinished, inliers = icp_graph.iterate(state.transform, scans, lines, options)
    converged = ~unfinished & (inliers >= options.min_pairs)
    unknown = torch.full_like(state.rmse, math.nan)
    return Alignment(transform, converged, inliers, unknown, torch.full_like(inliers, -1))


def _improve(
    transform: Tensor, scans: tuple[Tensor, ...], lines: ScanLines | None, options: IcpOptions
) -> tuple[Alignment, Tensor]:
    """Return the alignment after one more iteration, and whether its step was small, ``[S]``."""
    source, source_returns, target, target_returns = scans
    moved = se2.transform_points(transform, source)
    squared, index = nearest_returns(moved, target, target_returns)
    matched = source_returns & (squared <= options.gate**2)
    inliers = matched.sum(-1)
    enough = inliers >= options.min_pairs
    closest = take(target, index)
    if lines is None:
        step = fit_rigid(moved, closest, matched.to(moved.dtype))
    else:
        on_line = ScanLines(*(take(part, index) for part in lines))
        step = _line_step(moved, closest, matched, on_line, options.robust_scale)
    step = torch.where(enough.unsqueeze(-1), step, 0.0)
    small = step[:, 2].abs() < options.rotation_tolerance
    small &= torch.linalg.vector_norm(step[:, :2], dim=-1) < options.translation_tolerance
    transform, rmse = se2.compose(step, transform), _root_mean(squared, matched)
    return Alignment(transform, small & enough, inliers, rmse, torch.zeros_like(inliers)), small


def _line_step(
    points: Tensor,
    closest: Tensor,
    matched: Tensor,
    lines: ScanLines,
    robust_scale: float | None,
) -> Tensor:
    """Return the Gauss-Newton step ``[S, 3]`` for distances to the matched lines."""
    weight, _ = pair_weights(points, closest, matched, lines, robust_scale)
    normal_matrix, vector = line_equations(points, closest, weight, lines)
    damping = DAMPING * torch.eye(3, dtype=vector.dtype, device=vector.device)
    return -torch.linalg.solve(normal_matrix + damping, vector)


def _root_mean(squared: Tensor, matched: Tensor) -> Tensor:
    total = torch.where(matched, squared, 0.0).sum(-1)
    return (total / matched.sum(-1).clamp(min=1)).sqrt()


def _check_scans(
    source_points: Tensor,
    source_returns: Tensor,
    target_points: Tensor,
    target_returns: Tensor,
    options: IcpOptions,
) -> None:
    for name, points, returns in (
        ("source", source_points, source_returns),
        ("target", target_points, target_returns),
    ):
        if points.ndim < 2 or points.shape[-1] != 2 or points.shape[-2] < 1:
            raise ValueError(
                f"{name}_points: must have shape [*B, N, 2] with N >= 1, got {tuple(points.shape)}"
            )
        if returns.shape != points.shape[:-1] or returns.dtype != torch.bool:
            raise ValueError(
                f"{name}_returns: must be bool of shape {tuple(points.shape[:-1])}, "
                f"got {returns.dtype} of shape {tuple(returns.shape)}"
            )
    check_same_device(
        source_points=source_points,
        source_returns=source_returns,
        target_points=target_points,
        target_returns=target_returns,
    )
    if source_points.shape[:-2] != target_points.shape[:-2]:
        raise ValueError(
            f"source_points, target_points: must have the same batch shape, "
            f"got {tuple(source_points.shape)} and {tuple(target_points.shape)}"
        )
    if options.initialization == "rotation_search" and source_points.shape != target_points.shape:
        raise ValueError(
            f"initialization='rotation_search': must have as many source as target points, "
            f"got {source_points.shape[-2]} and {target_points.shape[-2]}"
        )
