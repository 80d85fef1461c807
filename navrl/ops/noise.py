"""Counter-based range noise that depends only on (seed, step, beam).

The generator has no state to save: an episode gets the same noise on every simulator, in any batch
and at any position in it. One hash provides the table rows of four beams.
"""

import math

import torch
from torch import Tensor

from navrl.ops.backend import Backend, is_compiled
from navrl.ops.beams import HIT_MARGIN

TABLE_SIZE = 4096
# splitmix64 (Steele, Lea, Flood 2014) as signed 64-bit integers, because torch multiplies int64
_GOLDEN = -7046029254386353131  # 0x9E3779B97F4A7C15
_MIX_1 = -4658895280553007687  # 0xBF58476D1CE4E5B9
_MIX_2 = -7723592293110705685  # 0x94D049BB133111EB


def noise_table(kind: str, amplitude: float) -> Tensor:
    """Return the quantiles of a noise distribution at the midpoints of 4,096 equal slices.

    Args:
        kind: ``gaussian`` (standard deviation = amplitude, truncated at 3.7 amplitudes),
            ``uniform`` (within +-amplitude) or ``none``.
        amplitude: Scale of the noise, m.

    Returns:
        [4096] float32 m, zero mean.

    Raises:
        ValueError: If ``kind`` is unknown, or ``amplitude`` is negative or not finite.

    Example:
        >>> table = noise_table("uniform", 0.01)
        >>> table.shape, table.max().round(decimals=3)
        (torch.Size([4096]), tensor(0.0100))
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
        raise ValueError(f"noise={kind!r}: must be gaussian, uniform or none")
    if not (amplitude >= 0.0 and math.isfinite(amplitude)):
        raise ValueError(f"noise amplitude={amplitude}: must be finite and not negative (m)")
    return (amplitude * quantiles).to(torch.float32)


def add_range_noise(
    ranges: Tensor,
    seed: Tensor,
    step: Tensor,
    table: Tensor,
    max_range: float,
    backend: Backend = "auto",
    scale: Tensor | None = None,
) -> Tensor:
    """Add noise to ranges; beams without a return retain exactly ``max_range``.

    Noise never turns a hit into a miss or a miss into a hit: hits stay in [0, max_range - 1 mm].

    Args:
        ranges: [N, beams] float32 m.
        seed: [N] int64, episode seed of each world.
        step: [N] int64, number of scans since the start of the episode.
        table: [4096] float32 m, from :func:`noise_table`, on the device of ``ranges``.
        max_range: Range of the sensor, m; a range at or above it is not a return.
        backend: See :mod:`navrl.ops.backend`; all backends agree bit for bit.
        scale: [N, beams] float32, factor of each beam's noise, computed without a kernel; None
            for 1.

    Returns:
        [N, beams] float32 m, a new tensor.

    Raises:
        ValueError: If a shape or dtype is invalid; the message names it.

    Example:
        >>> clean, table = torch.tensor([[1.0, 3.5]]), noise_table("gaussian", 0.01)
        >>> noisy = add_range_noise(clean, torch.tensor([7]), torch.tensor([0]), table, 3.5)
        >>> bool((noisy - clean)[0, 0].abs() < 0.05), float(noisy[0, 1])
        (True, 3.5)
    """
    if ranges.ndim != 2 or ranges.dtype != torch.float32:
        raise ValueError(
            f"ranges: must be [N, beams] float32, got {list(ranges.shape)} {ranges.dtype}"
        )
    num_worlds = ranges.shape[0]
    for name, counter in (("seed", seed), ("step", step)):
        if counter.shape != (num_worlds,) or counter.dtype != torch.int64:
            raise ValueError(
                f"{name}: must be [{num_worlds}] int64, got {list(counter.shape)} {counter.dtype}"
            )
    if table.shape != (TABLE_SIZE,) or table.dtype != torch.float32:
        raise ValueError(
            f"table: must be [{TABLE_SIZE}] float32, got {list(table.shape)} {table.dtype}"
        )
    if scale is None and is_compiled(backend, ranges, seed, step, table):
        from navrl.ops.kernels.noise import add_noise

        return add_noise(ranges, seed, step, table, max_range)
    noise = table[_table_rows(seed, step, ranges.shape[1])]
    noisy = ranges + (noise if scale is None else noise * scale)
    noisy = noisy.clamp(0.0, torch.tensor(max_range - HIT_MARGIN, dtype=torch.float32).item())
    return torch.where(ranges < max_range, noisy, ranges)


def _table_rows(seed: Tensor, step: Tensor, num_beams: int) -> Tensor:
    """Return [N, num_beams] int64 in [0, 4096): twelve bits of a hash per beam, four per hash."""
    key = mix(mix(seed + _GOLDEN) + step)
    beam = torch.arange(num_beams, device=seed.device)
    word = mix(key[:, None] + _GOLDEN * (beam // 4 + 1))
    return (word >> (12 * (beam % 4))) & (TABLE_SIZE - 1)


def uniform(seed: Tensor, stream: Tensor | int, step: Tensor | int = 0) -> Tensor:
    """Return uniform random numbers that depend only on (seed, stream, step).

    Args:
        seed: [*B] int64, episode seeds.
        stream: [*B] int64 or a number of the random variable; streams are independent.
        step: [*B] int64 or a number, counter within the episode.

    Returns:
        [*B] float64 in [0, 1), equal on all devices.

    Example:
        >>> first, second = uniform(torch.tensor([7, 8]), stream=1)
        >>> bool(0.0 <= first < 1.0), bool(first != second)
        (True, True)
    """
    word = mix(mix(mix(seed + _GOLDEN) + stream) + step)
    return _shift_right(word, 11).double() / (1 << 53)


def beam_uniform(seed: Tensor, stream: int, step: Tensor, num_beams: int) -> Tensor:
    """Return uniform random numbers that depend only on (seed, stream, step, beam).

    Args:
        seed: [N] int64, episode seeds.
        stream: Number of the random variable; streams are independent of each other.
        step: [N] int64, counter within the episode.
        num_beams: Number of beams; one hash provides the numbers of four.

    Returns:
        [N, num_beams] float32 in [0, 1), multiples of 2^-16, equal on all devices.

    Example:
        >>> share = beam_uniform(torch.tensor([7]), 1, torch.tensor([0]), 1440)
        >>> share.shape, bool((share.mean() - 0.5).abs() < 0.02)
        (torch.Size([1, 1440]), True)
    """
    key = mix(mix(mix(seed + _GOLDEN) + stream) + step)
    group = torch.arange((num_beams + 3) // 4, device=seed.device)
    word = mix(key[:, None] + _GOLDEN * (group + 1))
    parts = torch.stack([(word >> (16 * part)) & 0xFFFF for part in range(4)], dim=-1)
    return parts.flatten(-2)[:, :num_beams].float() / (1 << 16)


def mix(word: Tensor) -> Tensor:
    """Apply the splitmix64 finalizer; int64 arithmetic wraps, right shifts fill with zeros.

    Example:
        >>> mix(torch.tensor([0, 1]))
        tensor([                  0, 6238072747940578789])
    """
    word = (word ^ _shift_right(word, 30)) * _MIX_1
    word = (word ^ _shift_right(word, 27)) * _MIX_2
    return word ^ _shift_right(word, 31)


def _shift_right(word: Tensor, bits: int) -> Tensor:
    return (word >> bits) & ((1 << (64 - bits)) - 1)
