"""Exponents of the growth of costs with size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def fit_exponents(sizes: Sequence[float], costs: np.ndarray) -> np.ndarray:
    """Fit ``cost = a * size ** b`` by least squares of the logarithms.

    Args:
        sizes: ``[n]``, positive, at least two different ones.
        costs: ``[..., n]``, positive.

    Returns:
        ``[...]``, exponents b; 1 for linear growth.

    Raises:
        ValueError: If there are fewer than two sizes, or a number is not positive.
    """
    sizes, costs = np.asarray(sizes, dtype=float), np.asarray(costs, dtype=float)
    if len(set(sizes.tolist())) < 2 or costs.shape[-1:] != sizes.shape:
        raise ValueError(
            f"sizes: must be at least two different ones with a cost for each, "
            f"got {sizes.tolist()} and costs of shape {list(costs.shape)}"
        )
    if not (sizes > 0).all() or not (costs > 0).all():
        raise ValueError("sizes, costs: must be positive")
    x = np.log(sizes) - np.log(sizes).mean()
    return np.log(costs) @ x / (x @ x)
