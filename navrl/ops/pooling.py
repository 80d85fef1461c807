"""Min-pooling of a lidar scan: from many beams to a few points, losing no near obstacle."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from navrl.ops.backend import Backend, is_compiled

# A reading closer to the maximum than this is the maximum: float noise never makes a return.
RETURN_MARGIN_M = 1e-4

Bearing = Literal["bin", "beam"]


class PooledScan(NamedTuple):
    """Result of :func:`min_pool`."""

    ranges: Tensor
    """``[*B, N]`` m, the nearest return of each bin, ``max_range`` where there is none."""
    points: Tensor
    """``[*B, N, 2]`` m, robot frame; a bin without return lies at ``max_range``."""
    returns: Tensor
    """``[*B, N]`` bool, whether the bin saw anything."""


def min_pool(
    ranges: Tensor,
    group_size: int = 8,
    max_range: float = 3.5,
    bearing: Bearing = "bin",
    backend: Backend = "auto",
) -> PooledScan:
    """Keep the nearest of each ``group_size`` neighbouring beams.

    The minimum is safe: the nearest obstacle of the scan is always among the pooled points. A
    reading is a return if ``0 < r < max_range``. Everything else (maximum range or more, infinity,
    NaN, zero or less, as drivers report a miss) is no return, so one broken beam never
    contaminates its neighbours.

    Args:
        ranges: ``[*B, beams]`` m, beam j at ``2*pi*j/beams`` counter-clockwise from straight ahead.
        group_size: Number of beams in a bin; must divide the number of beams.
        max_range: Range of the sensor, m.
        bearing: Where a point is drawn: ``"bin"`` at the centre angle of its bin, ``"beam"`` at the
            angle of the beam that measured it.
        backend: See :mod:`navrl.ops.backend`; all agree bit for bit.

    Returns:
        The pooled scan with ``N = beams / group_size`` points, ordered by bearing.

    Raises:
        ValueError: If an argument is outside the above, naming it.

    Reference:
        Paper Sec. IV-G (1,440 beams) and IV-C (min-pooled to 180). The bearing of a
        pooled point is not given there; the bin's centre is the authors' precursor's choice, and
        ``"beam"`` is up to half a bin (0.9 deg) more exact.
    """
    check_pooling(ranges.shape, group_size, max_range, bearing)
    if is_compiled(backend, ranges):
        return _min_pool_compiled(ranges, group_size, max_range, bearing)
    is_return = (ranges > 0.0) & (ranges < max_range - RETURN_MARGIN_M)  # False for NaN
    beams = torch.where(is_return, ranges, max_range).unflatten(-1, (-1, group_size))
    nearest, index = beams.min(dim=-1)
    returns = nearest < max_range
    angle = bin_centres(ranges.shape[-1], group_size, ranges.dtype, ranges.device)
    if bearing == "beam":
        offset = beam_offsets(index, ranges.shape[-1], group_size, ranges.dtype)
        angle = angle + torch.where(returns, offset, 0.0)
    direction = torch.stack([angle.cos(), angle.sin()], dim=-1)
    return PooledScan(nearest, nearest.unsqueeze(-1) * direction, returns)


def check_pooling(
    shape: torch.Size, group_size: int, max_range: float, bearing: Bearing = "bin"
) -> None:
    """Raise a ValueError that names the argument of :func:`min_pool` which cannot be."""
    if len(shape) < 1 or shape[-1] < 1:
        raise ValueError(f"ranges must have shape [*B, beams], got {tuple(shape)}")
    if group_size < 1:
        raise ValueError(f"group_size must be at least 1, got {group_size}")
    if shape[-1] % group_size:
        raise ValueError(
            f"group_size must divide the number of beams: {shape[-1]} beams, "
            f"group_size {group_size}"
        )
    if not max_range > RETURN_MARGIN_M:
        raise ValueError(f"max_range must be positive, got {max_range}")
    if bearing not in ("bin", "beam"):
        raise ValueError(f"bearing must be 'bin' or 'beam', got {bearing!r}")


def _min_pool_compiled(
    ranges: Tensor, group_size: int, max_range: float, bearing: Bearing
) -> PooledScan:
    from navrl.ops.kernels.pooling import pool

    batch = ranges.shape[:-1]
    flat = ranges.reshape(batch.numel(), ranges.shape[-1])
    pooled = pool(flat, group_size, max_range, bearing)
    return PooledScan(*(values.reshape(batch + values.shape[1:]) for values in pooled))


def bin_centres(
    num_beams: int,
    group_size: int,
    dtype: torch.dtype,
    device: torch.device | str = "cpu",
) -> Tensor:
    """Return the centre angle of each bin, ``[N]`` rad."""
    first_beam = torch.arange(0, num_beams, group_size, device=device, dtype=dtype)
    return (first_beam + 0.5 * (group_size - 1)) * (2.0 * math.pi / num_beams)


def beam_offsets(index: Tensor, num_beams: int, group_size: int, dtype: torch.dtype) -> Tensor:
    """Return the angle, rad, from a bin's centre to the ``index``-th of its beams."""
    return (index.to(dtype) - 0.5 * (group_size - 1)) * (2.0 * math.pi / num_beams)
