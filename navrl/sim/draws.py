"""Values that are fixed or drawn once per episode from the scenario's seed."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from navrl.ops.noise import uniform


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution of a value that is drawn once per episode.

    Args:
        low: Smallest value.
        high: Largest value.

    Raises:
        ValueError: If a limit is not finite or ``low`` exceeds ``high``.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        """Check the bounds."""
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low <= self.high):
            raise ValueError(f"low={self.low}, high={self.high}: must be finite and low <= high")

    def quantile(self, share: Tensor) -> Tensor:
        """Return the quantiles at shares [*B] float64 in [0, 1]."""
        return self.low + (self.high - self.low) * share


@dataclass(frozen=True)
class LogUniform(Uniform):
    """Log-uniform distribution, for positive values that span a decade or more.

    Args:
        low: Smallest value, positive.
        high: Largest value.

    Raises:
        ValueError: If a limit is not finite, ``low`` is not positive or exceeds ``high``.

    Example:
        >>> round(LogUniform(0.1, 10.0).quantile(torch.tensor(0.5)).item(), 6)
        1.0
    """

    def __post_init__(self) -> None:
        """Check the bounds."""
        super().__post_init__()
        if self.low <= 0.0:
            raise ValueError(f"low={self.low}: must be positive for a log-uniform distribution")

    def quantile(self, share: Tensor) -> Tensor:
        """Return the quantiles at shares [*B] float64 in [0, 1], equal on all devices."""
        value = self.low * exp(share.double() * math.log(self.high / self.low))
        return value.clamp(self.low, self.high)


def exp(x: Tensor) -> Tensor:
    """Return e^x, relative error below 1e-9 for 0 <= x <= 10.

    The result is equal on all devices and in any batch, because additions and multiplications are
    rounded exactly; the rounding of ``torch.exp`` depends on the position in the batch.
    """
    y = x / 4096.0
    power = 1.0 + y * (1.0 + y / 2.0 * (1.0 + y / 3.0 * (1.0 + y / 4.0)))
    for _ in range(12):
        power = power * power
    return power


Value = float | Uniform
"""A fixed number, or a distribution of which each episode draws one."""


def draw(name: str, value: Value, seed: Tensor, step: Tensor | int = 0) -> Tensor:
    """Return the value of each episode.

    The same name, seed and step give the same value on every simulator and device, in any batch.

    Args:
        name: Name of the value; values of different names are independent.
        value: Fixed number or distribution.
        seed: [M] int64, ``noise_seed`` of the scenarios.
        step: [M] int64 or a number, for values that are drawn at each step.

    Returns:
        [M] float64 on the device of ``seed``.

    Example:
        >>> seed = torch.tensor([3, 4])
        >>> draw("lag_s", 0.1, seed).tolist()
        [0.1, 0.1]
        >>> low, high = draw("lag_s", Uniform(0.0, 0.3), seed).aminmax()
        >>> bool(0.0 <= low < high <= 0.3)
        True
    """
    if not isinstance(value, Uniform):
        return torch.full(seed.shape, float(value), dtype=torch.float64, device=seed.device)
    share = uniform(seed, zlib.crc32(name.encode()), step)
    return value.quantile(share)


def draw_row(values: Sequence[tuple[str, Value]], seed: Tensor) -> Tensor:
    """Return several values of each episode, the same as :func:`draw` but faster.

    Args:
        values: V pairs of name and value.
        seed: [M] int64, ``noise_seed`` of the scenarios.

    Returns:
        [M, V] float64 on the device of ``seed``.

    Example:
        >>> draw_row([("lag_s", 0.1), ("scale", 1.0)], torch.tensor([3])).tolist()
        [[0.1, 1.0]]
    """
    streams = [zlib.crc32(name.encode()) for name, _ in values]
    shares = uniform(seed[:, None], torch.tensor(streams, device=seed.device)).unbind(-1)
    columns = [
        value.quantile(share) if isinstance(value, Uniform) else torch.full_like(share, value)
        for (_, value), share in zip(values, shares, strict=True)
    ]
    return torch.stack(columns, dim=-1)


def limits(value: Value) -> tuple[float, float]:
    """Return the smallest and the largest possible value."""
    return (value.low, value.high) if isinstance(value, Uniform) else (value, value)


def check_not_negative(wanted: str = "finite and not negative", **values: Value) -> None:
    """Check that fixed values and all drawn ones are finite and at least zero.

    Args:
        wanted: What is allowed, for the message.
        **values: Values by name.

    Raises:
        ValueError: If one is not; the message has its name.
    """
    for name, value in values.items():
        low, high = limits(value)
        if not 0.0 <= low <= high < math.inf:
            raise ValueError(f"{name}={value}: must be {wanted}")


def nominal(value: Value) -> float:
    """Return a fixed value itself, and the median of a distribution."""
    if not isinstance(value, Uniform):
        return float(value)
    return float(value.quantile(torch.tensor(0.5, dtype=torch.float64)))
