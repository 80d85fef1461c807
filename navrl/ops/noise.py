"""Range noise that depends on (seed, step, beam) alone.

A counter-based generator: no state to save, the same noise for an episode on every simulator, in
any batch and at any position of it. One hash gives the table rows of four beams.
"""

import math

import torch
from torch import Tensor

from navrl.ops.backend import Backend, is_compiled
from navrl.ops.beams import HIT_MARGIN

TABLE_SIZE = 4096
# splitmix64 (Steele, Lea, Flood 2014) as signed 64-bit numbers, which is what torch multiplies
_GOLDEN = -7046029254386353131  # 0x9E3779B97F4A7C15
_MIX_1 = -4658895280553007687  # 0xBF58476D1CE4E5B9
_MIX_2 = -7723592293110705685  # 0x94D049BB133111EB


def noise_table(kind: str, amplitude: float) -> Tensor:
    """Quantiles that the noise is drawn from, at the middles of 4,096 equal slices.

    Args:
        kind: ``gaussian`` (standard deviation = amplitude, ends at 3.7 amplitudes), ``uniform``
            (within +-amplitude) or ``none``.
        amplitude: m.

    Returns:
        [4096] float32 m, mean zero.
    """
    middle = (torch.arange(TABLE_SIZE, dtype=torch.float64) + 0.5) / TABLE_SIZE
    if kind == "gaussian":
        quantiles = torch.special.ndtri(middle)
        quantiles = quantiles / quantiles.square().mean().sqrt()
    elif kind == "uniform":
        quantiles = 2.0 * middle - 1.0
    elif kind == "none":
        quantiles = torch.zeros_like(middle)
    else:
        raise ValueError(f"noise must be gaussian, uniform or none, got {kind!r}")
    if not (amplitude >= 0.0 and math.isfinite(amplitude)):
        raise ValueError(f"noise amplitude must be finite and not negative, got {amplitude}")
    return (amplitude * quantiles).to(torch.float32)


def add_range_noise(
    ranges: Tensor,
    seed: Tensor,
    step: Tensor,
    table: Tensor,
    max_range: float,
    backend: Backend = "auto",
) -> Tensor:
    """Return noisy ranges; beams without a return keep exactly ``max_range``.

    Noise never makes a miss of a hit nor a hit of a miss: hits stay in [0, max_range - 1 mm].

    Args:
        ranges: [N, beams] float32 m.
        seed: [N] int64, of each world's episode.
        step: [N] int64, scans since the episode's start.
        table: [4096] float32 m, from :func:`noise_table`, on the ranges' device.
        max_range: m; a range at or above it is no return.
        backend: see :mod:`navrl.ops.backend`; all agree bit for bit.

    Returns:
        [N, beams] float32 m, a new tensor.
    """
    if ranges.ndim != 2 or ranges.dtype != torch.float32:
        raise ValueError(
            f"ranges must be [N, beams] float32, got {list(ranges.shape)} {ranges.dtype}"
        )
    num_worlds = ranges.shape[0]
    for name, counter in (("seed", seed), ("step", step)):
        if counter.shape != (num_worlds,) or counter.dtype != torch.int64:
            raise ValueError(
                f"{name} must be [{num_worlds}] int64, got {list(counter.shape)} {counter.dtype}"
            )
    if table.shape != (TABLE_SIZE,) or table.dtype != torch.float32:
        raise ValueError(f"table must be [{TABLE_SIZE}] float32, got {list(table.shape)}")
    if is_compiled(backend, ranges, seed, step, table):
        from navrl.ops.kernels.noise import add_noise

        return add_noise(ranges, seed, step, table, max_range)
    noisy = ranges + table[_table_rows(seed, step, ranges.shape[1])]
    noisy = noisy.clamp(0.0, torch.tensor(max_range - HIT_MARGIN, dtype=torch.float32).item())
    return torch.where(ranges < max_range, noisy, ranges)


def _table_rows(seed: Tensor, step: Tensor, num_beams: int) -> Tensor:
    """Return [N, num_beams] int64 in [0, 4096): twelve bits of a hash each, four beams a hash."""
    key = _mix(_mix(seed + _GOLDEN) + step)
    beam = torch.arange(num_beams, device=seed.device)
    word = _mix(key[:, None] + _GOLDEN * (beam // 4 + 1))
    return (word >> (12 * (beam % 4))) & (TABLE_SIZE - 1)


def _mix(word: Tensor) -> Tensor:
    """splitmix64's finaliser; int64 arithmetic wraps around, right shifts fill with zeros."""
    word = (word ^ _shift_right(word, 30)) * _MIX_1
    word = (word ^ _shift_right(word, 27)) * _MIX_2
    return word ^ _shift_right(word, 31)


def _shift_right(word: Tensor, bits: int) -> Tensor:
    return (word >> bits) & ((1 << (64 - bits)) - 1)
