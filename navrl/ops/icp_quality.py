"""Reliability of a scan alignment, and alignment that starts from odometry."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from navrl.ops import se2
from navrl.ops.backend import Backend, as_real
from navrl.ops.exporting import symmetric_eigen
from navrl.ops.icp import Alignment, align
from navrl.ops.icp_options import IcpOptions
from navrl.ops.icp_pairs import line_equations, nearest_returns, pair_weights, take
from navrl.ops.lines import fit_lines
from navrl.ops.returns import finite_returns

# m, residual below which a pair supports the alignment: 4 sigma of the paper's noise
INLIER_M = 0.1


class Quality(NamedTuple):
    """Result of :func:`alignment_quality`."""

    inlier_share: Tensor
    """``[*B]`` share of the source returns that lie within 0.1 m of the target's surface."""
    rms: Tensor
    """``[*B]`` m, root mean square residual of these returns."""
    eigenvalues: Tensor
    """``[*B, 3]`` ascending, of the normalized information matrix."""
    eigenvectors: Tensor
    """``[*B, 3, 3]`` their columns: directions (x, y, length times yaw) in the target's frame."""
    length: Tensor
    """``[*B]`` m by which yaw is scaled: root mean square distance of the matched returns."""


def alignment_quality(
    transform: Tensor,
    source_points: Tensor,
    source_returns: Tensor,
    target_points: Tensor,
    target_returns: Tensor,
    options: IcpOptions,
) -> Quality:
    """Return how well, and in which directions, two scans determine the motion between them.

    The information matrix is that of the point-to-line distances at ``transform``, robustly
    weighted, with yaw scaled by the scene's size and divided by the information about both
    translations. An eigenvalue is then the share of the returns that constrain its direction: 0.5
    for both translations in a square room, near 0 along a corridor without visible ends.

    Args:
        transform: ``[*B, 3]`` (m, m, rad) T_target_source.
        source_points: ``[*B, N, 2]`` m.
        source_returns: ``[*B, N]`` bool.
        target_points: ``[*B, M, 2]`` m, ordered by bearing.
        target_returns: ``[*B, M]`` bool.
        options: Gate and robust scale of the alignment.

    Returns:
        The quality; zeros for scans without matches.

    Example:
        >>> y = torch.linspace(-0.5, 0.5, 12)
        >>> wall = torch.stack([torch.ones(12), y], dim=-1)
        >>> is_return = torch.ones(12, dtype=torch.bool)
        >>> found = alignment_quality(
        ...     torch.zeros(3), wall, is_return, wall, is_return, IcpOptions()
        ... )
        >>> found.inlier_share, found.eigenvalues[0].abs().round(decimals=3)  # free along the wall
        (tensor(1.), tensor(0.))

    Reference:
        Zhang, Kaess and Singh, "On degeneracy of optimization-based state estimation problems",
        ICRA 2016, whose eigenvalues are not normalized.
    """
    batch = transform.shape[:-1]
    points, target = as_real(source_points), as_real(target_points)
    source_returns = finite_returns(points, source_returns)
    target_returns = finite_returns(target, target_returns)
    points = torch.where(source_returns.unsqueeze(-1), points, 0.0)
    target = torch.where(target_returns.unsqueeze(-1), target, 0.0)
    scans = (transform, points, source_returns, target, target_returns)
    flat = [scan.reshape(-1, *scan.shape[len(batch) :]) for scan in scans]
    parts = _measure(*flat, options=options)
    return Quality(*(part.reshape(batch + part.shape[1:]) for part in parts))


def _measure(
    transform: Tensor,
    points: Tensor,
    returns: Tensor,
    target: Tensor,
    target_returns: Tensor,
    options: IcpOptions,
) -> Quality:
    moved = se2.transform_points(transform, points)
    squared, index = nearest_returns(moved, target, target_returns)
    matched = returns & (squared <= options.gate**2)
    lines = type(fitted := fit_lines(target, target_returns))(*(take(p, index) for p in fitted))
    closest = take(target, index)
    weight, residual = pair_weights(moved, closest, matched, lines, options.robust_scale)
    is_inlier = matched & (residual < INLIER_M)
    count = is_inlier.sum(-1)
    rms = (torch.where(is_inlier, residual, 0.0).square().sum(-1) / count.clamp(min=1)).sqrt()
    share = count.to(moved.dtype) / returns.sum(-1).clamp(min=1)
    distance = torch.where(matched, moved.square().sum(-1), 0.0).sum(-1)
    length = (distance / matched.sum(-1).clamp(min=1)).sqrt().clamp(min=1e-3)
    matrix, _ = line_equations(moved, closest, weight, lines, slide_weight=0.0)
    scale = torch.ones_like(transform)
    scale[:, 2] = 1.0 / length
    total = (matrix[:, 0, 0] + matrix[:, 1, 1]).clamp(min=1e-9)
    matrix = matrix * scale.unsqueeze(-1) * scale.unsqueeze(-2) / total[:, None, None]
    values, vectors = symmetric_eigen(matrix.double())
    values, vectors = values.clamp(min=0.0).to(moved.dtype), vectors.to(moved.dtype)
    return Quality(share, rms, values, vectors, length)


def align_from_prior(
    prior: Tensor,
    source_points: Tensor,
    source_returns: Tensor,
    target_points: Tensor,
    target_returns: Tensor,
    options: IcpOptions,
    min_eigenvalue: float = 0.1,
    backend: Backend = "auto",
) -> Alignment:
    """Align scans from an odometry prior that holds the directions the scans leave free.

    The alignment starts at the prior. Its correction is then projected on the directions whose
    eigenvalue at the prior reaches ``min_eigenvalue``. There a pedestrian does not lie on the
    previous scan and is down-weighted; at the result of ICP it may, if all of the scan was moved
    along a corridor to match it.

    Args:
        prior: ``[*B, 3]`` (m, m, rad) T_target_source by odometry. It must be closer than the gate.
        source_points: ``[*B, N, 2]`` m.
        source_returns: ``[*B, N]`` bool.
        target_points: ``[*B, M, 2]`` m, ordered by bearing.
        target_returns: ``[*B, M]`` bool.
        options: Settings of the alignment; the prior replaces a rotation search.
        min_eigenvalue: See :func:`alignment_quality`; 0 holds no direction.
        backend: See :func:`navrl.ops.icp.align`.

    Returns:
        The alignment; the prior where it failed.

    Example:
        >>> x = torch.linspace(-1.0, 1.0, 20)
        >>> wall = torch.stack([x, torch.ones(20)], dim=-1)
        >>> is_return = torch.ones(20, dtype=torch.bool)
        >>> prior = torch.tensor([0.2, 0.05, 0.0])  # across the wall it is off by 0.05 m
        >>> found = align_from_prior(prior, wall, is_return, wall, is_return, IcpOptions())
        >>> found.transform.round(decimals=3).abs()
        tensor([0.2000, 0.0000, 0.0000])

    Reference:
        Zhang, Kaess and Singh, ICRA 2016: solution remapping, here applied once to the whole
        correction, which is equal for corrections within the gate.
    """
    prior = prior.to(as_real(source_points).dtype)
    moved = se2.transform_points(prior, as_real(source_points))
    target = (target_points, target_returns)
    from_prior = replace(options, initialization="identity")
    result = align(moved, source_returns, *target, from_prior, backend)
    held = alignment_quality(prior, source_points, source_returns, *target, options)
    scale = torch.ones_like(prior)
    scale[..., 2] = held.length
    is_known = (held.eigenvalues >= min_eigenvalue).to(prior.dtype)
    basis = held.eigenvectors
    part = (basis.mT @ (scale * result.transform).unsqueeze(-1)).squeeze(-1)
    correction = (basis @ (is_known * part).unsqueeze(-1)).squeeze(-1) / scale
    return result._replace(transform=se2.compose(correction, prior))
