"""How long a controller thinks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def controller_latency(decision_s: Sequence[float]) -> dict[str, float]:
    """Return statistics of how long decisions took.

    It is measured by the clock, so it is no part of the files that are the same byte for byte.

    Args:
        decision_s: s of each call of the policy, from the observation to the command; at least one.
            The first call, which may compile or allocate, should not be among them.

    Returns:
        ``mean_ms``, ``median_ms``, ``p95_ms``, ``max_ms`` and ``calls``.

    Raises:
        ValueError: If there is none.

    Reference:
        Computation time, the most common addition to the metrics of Francis et al. 2023.
    """
    if not len(decision_s):
        raise ValueError("decision_s: need at least one decision, got none")
    ms = 1e3 * np.asarray(decision_s, dtype=float)
    return {
        "mean_ms": float(ms.mean()),
        "median_ms": float(np.median(ms)),
        "p95_ms": float(np.percentile(ms, 95)),
        "max_ms": float(ms.max()),
        "calls": len(ms),
    }
