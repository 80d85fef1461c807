"""Names of the rows of ``navrl-benchmark``; importing this loads no torch."""

from __future__ import annotations

from collections.abc import Sequence

from navrl.config import did_you_mean

ROWS = (
    *("scan", "peers", "step", "icp_tagd", "growth", "memory", "update", "training", "workers"),
    *("latency", "startup", "deploy", "compile", "gpu"),
)


def check_rows(names: Sequence[str]) -> None:
    """Check that rows are known and named once.

    Raises:
        ValueError: If a row is unknown or named twice, or there is none.
    """
    unknown = [name for name in names if name not in ROWS]
    if unknown or not names or len(set(names)) < len(names):
        near = did_you_mean(str(unknown[0]), ROWS) if unknown else ""
        raise ValueError(f"rows={list(names)}: must be distinct ones of {sorted(ROWS)}{near}")
