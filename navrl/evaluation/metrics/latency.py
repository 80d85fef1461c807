"""Latency of a controller's decisions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def controller_latency(decision_s: Sequence[float]) -> dict[str, float]:
    """Return statistics of decision times.

    Latency depends on the clock, so it is not part of the reproducible files.

    Args:
        decision_s: Duration of each call of the policy, observation to command, s; at least one.
            Exclude the first call, which may compile or allocate.

    Returns:
        ``mean_ms``, ``median_ms``, ``p95_ms``, ``max_ms`` and ``calls``.

    Raises:
        ValueError: If there are no values.

    Example:
        >>> controller_latency([0.001, 0.002, 0.006])["mean_ms"]
        3.0

    Reference:
        Computation time, the most common addition to the metrics of Francis et al. 2023.
    """
    if not len(decision_s):
        raise ValueError("decision_s=[]: must have at least one decision")
    ms = 1e3 * np.asarray(decision_s, dtype=float)
    return {
        "mean_ms": float(ms.mean()),
        "median_ms": float(np.median(ms)),
        "p95_ms": float(np.percentile(ms, 95)),
        "max_ms": float(ms.max()),
        "calls": len(ms),
    }
